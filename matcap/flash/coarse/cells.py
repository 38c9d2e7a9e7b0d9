"""The coarse fit's model and observations: cells, uniform material, camera and flash."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.cook_torrance import MIN_ROUGHNESS
from matcap.flash.highlight import Highlight
from matcap.flash.light import CORNER_SQUARED
from matcap.flash.rectify import MOST_LEFT_OUT
from matcap.photo.left_out import area_averaged
from matcap.photo.photo import FULL, Photo

Doubles = NDArray[np.float64]

# The coarse fit's model: parameters, and log radiance of a uniform material in the camera frame.
#
# With the diffuse albedo a (0.005 F0 of a conductor), roughness r, and E the irradiance of
# flash/light.py,
#
# log L = log(a E / pi + specular(F0, r) E) - vignetting.
#
# In NumPy: of a few hundred points, most of PyTorch's time is spent in its calls.

_DARKEST = 1e-12  # radiance added before logarithms
_OUTSIDE = 0.1  # of the largest channel of albedo, by which the least may be below 0
BLACK = 0.005  # diffuse albedo of a conductor over its F0
_STEP = 1e-5  # of finite differences in unknowns, all of which are of order 1


_ENDS = (0, 3, 4, 5, 6, 8, 10, 12, 14, 16, 17)  # of the unknowns in Unknowns.vector()


@dataclass(frozen=True)
class Unknowns:
    """The fitted parameters, scaled to order 1; any leading dimensions."""

    albedo: Doubles
    """(..., 3) log of diffuse albedo; of a conductor, log of F0."""
    specular: Doubles
    """(..., 1) log of a dielectric's F0."""
    roughness: Doubles
    """(..., 1) logit."""
    intensity: Doubles
    """(..., 1) log of the flash's, in green."""
    flash_colour: Doubles
    """(..., 2) log of the flash's intensity in red and in blue over that."""
    offset: Doubles
    """(..., 2) of the flash from the camera, plane units."""
    tilt: Doubles
    """(..., 2) radians."""
    vignetting: Doubles
    """(..., 2) with r^2 and with r^4, as FlashSetup has them."""
    centre: Doubles
    """(..., 2) of the vignetting, image coordinates."""
    tone: Doubles
    """(..., 1) log of the tone curve's exponent."""

    def vector(self) -> Doubles:
        """(..., 17) all of them."""
        return np.concatenate([getattr(self, f.name) for f in fields(self)], axis=-1)

    @staticmethod
    def of(vector: NDArray[Any]) -> Unknowns:
        """The inverse of vector()."""
        return Unknowns(*(vector[..., first:end] for first, end in pairwise(_ENDS)))

    @property
    def flash(self) -> Doubles:
        """(..., 3) log of the flash's intensity by channel."""
        return self.intensity + self.flash_colour @ np.eye(3)[[0, 2]]


COUNT = _ENDS[-1]  # of unknowns
INDEX = Unknowns.of(np.arange(COUNT))  # of each unknown in vector()
# Unknowns by which a model is differentiated by finite differences.
_GEOMETRY = np.concatenate([INDEX.roughness, INDEX.offset, INDEX.tilt])


class Linear(NamedTuple):
    """Values at n points and their Jacobian."""

    value: Doubles
    """(..., n)"""
    by: Doubles
    """(17, ..., n) derivatives by the unknowns."""


def log_radiance(
    parameters: Doubles, image: Doubles, distance: float, *, conductor: bool = False
) -> tuple[Linear, Linear]:
    """(3, n) log radiance of the uniform material, and (n,) its diffuse share under a white flash.

    Args:
        parameters: (17,) unknowns.
        image: (2, n) image coordinates.
        distance: of the camera, plane units.
        conductor: `albedo` is F0, and hardly anything is diffuse.
    """
    unknowns = Unknowns.of(parameters)
    irradiance, lobe, grazing = _light(Unknowns.of(_varied(parameters)), image, distance)
    if conductor:
        f0 = np.exp(unknowns.albedo)[:, None]
        albedo, by_albedo = BLACK * f0, np.diag(BLACK * f0[:, 0])
    else:
        f0 = np.exp(unknowns.specular)[:, None]
        signed, by_albedo = signed_albedo(unknowns.albedo)
        albedo = signed[:, None]
    # Of the point itself and of steps in _GEOMETRY: (6, 3, n).
    matte, mirrored = albedo / math.pi, lobe * (f0 + (1.0 - f0) * grazing)
    power = irradiance * np.exp(unknowns.flash)[:, None]
    radiance = np.maximum((matte + mirrored) * power, 0.0)
    log = np.log(radiance + _DARKEST)
    by = np.zeros((COUNT, *log.shape[1:]))
    by[_GEOMETRY] = (log[1:] - log[0]) / _STEP
    relative = radiance[0] / (radiance[0] + _DARKEST)
    unit = np.where(radiance[0] > 0.0, power[0], 0.0) / (radiance[0] + _DARKEST)
    by_f0 = lobe[0] * (1.0 - grazing[0]) * f0  # of the specular part, by the log of F0
    by[INDEX.albedo] = by_albedo.T[..., None] / math.pi * unit
    if conductor:
        by[INDEX.albedo] += np.eye(3)[..., None] * by_f0 * unit
    else:
        by[INDEX.specular] = by_f0 * unit
    by[INDEX.intensity] = relative
    by[INDEX.flash_colour, (0, 2)] = relative[[0, 2]]
    reflected = np.maximum((matte + mirrored).mean(1), _DARKEST)
    share = matte.mean() / reflected
    share_by = np.zeros((COUNT, share.shape[1]))
    share_by[_GEOMETRY] = (share[1:] - share[0]) / _STEP
    if not conductor:
        by_reflected = share[0] * (reflected[0] > _DARKEST)
        share_by[INDEX.albedo] = by_albedo.mean(0)[:, None] / math.pi * (1.0 - by_reflected)
        share_by[INDEX.specular] = -by_f0 * by_reflected
        share_by[[*INDEX.albedo, *INDEX.specular]] /= reflected[0]
    return _vignetted(Linear(log[0], by), unknowns, image), Linear(share[0], share_by)


def _varied(parameters: Doubles) -> Doubles:
    """(6, 17) parameters, and these with a step in each of _GEOMETRY."""
    steps = _STEP * np.eye(COUNT)[_GEOMETRY]
    return parameters + np.concatenate([np.zeros((1, COUNT)), steps])


def _light(unknowns: Unknowns, image: Doubles, distance: float) -> tuple[Doubles, Doubles, Doubles]:
    """Irradiance by a flash of intensity 1, D G / (4 (n.l)(n.v)), and (1 - l.h)^5 of Schlick.

    (m, 1, n) each, of unknowns (m, ...); 0 where light or view is below the surface. The equations
    of brdf/cook_torrance.py, of `Angles.exact`.
    """
    normal, camera, flash = _places(unknowns, distance)
    # Points where the rays meet the tilted plane.
    ray = np.stack([*image, np.full_like(image[0], -distance)])
    along = -(normal[:, 2:] * distance) / (normal @ ray)
    points = camera[:, None] + along[:, None] * ray
    to_flash = flash[..., None] - points
    squared = np.square(to_flash).sum(1, keepdims=True)
    light = to_flash / np.sqrt(squared)
    view = -ray / np.sqrt(np.square(ray).sum(0))
    middle = light + view
    length = np.sqrt(np.square(middle).sum(1, keepdims=True))
    n_dot_l, n_dot_v = (np.maximum(normal[:, None] @ each, 0.0) for each in (light, view))
    # |n x h|^2 by the chord |n - h|, without cancellation.
    chord = np.square(normal[..., None] - middle / length).sum(1, keepdims=True)
    sine_squared = chord * (1.0 - 0.25 * chord)
    roughness = 1.0 / (1.0 + np.exp(-unknowns.roughness[..., None]))
    alpha_squared = np.maximum(roughness, MIN_ROUGHNESS) ** 4
    rest = 1.0 - alpha_squared
    ggx = alpha_squared / np.square(alpha_squared + rest * sine_squared) / math.pi
    towards_view = n_dot_l * np.sqrt(np.square(n_dot_v) * rest + alpha_squared)
    towards_light = n_dot_v * np.sqrt(np.square(n_dot_l) * rest + alpha_squared)
    lit = (n_dot_l > 0.0) & (n_dot_v > 0.0)
    visibility = np.divide(0.5, towards_view + towards_light, out=np.zeros_like(ggx), where=lit)
    return lit * n_dot_l / squared, ggx * visibility, (1.0 - 0.5 * length) ** 5


def _vignetted(log: Linear, unknowns: Unknowns, image: Doubles) -> Linear:
    """Log radiance (3, n) with the vignetting of flash/light.py."""
    place = (image - unknowns.centre[:, None]) / CORNER_SQUARED
    squared = CORNER_SQUARED * np.square(place).sum(0)
    falloff, quartic = unknowns.vignetting
    log.by[INDEX.vignetting] = -np.stack([squared, np.square(squared)])[:, None]
    log.by[INDEX.centre] = 2.0 * ((falloff + 2.0 * quartic * squared) * place)[:, None]
    return Linear(log.value - squared * (falloff + quartic * squared), log.by)


def signed_albedo(log: Doubles) -> tuple[Doubles, Doubles]:
    """(3,) diffuse albedo of its unknown, and (3, 3) derivatives by channel and unknown.

    Of a colour outside sRGB the least channel is negative. A file clips it at 0 except under the
    highlight, where it darkens the channel. With a positive one, the flash would take that colour:
    pink, of a blue paint.
    """
    positive = np.exp(log)
    largest = np.arange(3) == positive.argmax()
    derivatives = np.diag((1.0 + _OUTSIDE) * positive) - _OUTSIDE * positive * largest
    return positive - _OUTSIDE * (positive.max() - positive), derivatives


def mirror_point(parameters: Doubles, distance: float) -> Linear:
    """(2,) image coordinates of the mirror point."""
    normal, camera, flash = _places(Unknowns.of(_varied(parameters)), distance)
    height, flash_height = (normal @ camera)[:, None], (normal * flash).sum(-1, keepdims=True)
    point = (camera - height * normal) * flash_height + (flash - flash_height * normal) * height
    point = point / (height + flash_height)
    image = point[:, :2] * (distance / (distance - point[:, 2:]))
    by = np.zeros((COUNT, 2))
    by[_GEOMETRY] = (image[1:] - image[0]) / _STEP
    return Linear(image[0], by)


def _places(unknowns: Unknowns, distance: float) -> tuple[Doubles, Doubles, Doubles]:
    """In the camera frame: the plane's normal (m, 3), places of camera (3,) and flash (m, 3)."""
    (sine_x, sine_y), (cosine_x, cosine_y) = np.sin(unknowns.tilt).T, np.cos(unknowns.tilt).T
    # setup_rotation()[:, 2]
    normal = np.stack([sine_y * cosine_x, -sine_x, cosine_y * cosine_x], axis=-1)
    camera = np.array([0.0, 0.0, distance])
    return normal, camera, camera + unknowns.offset @ np.eye(2, 3)


# The coarse fit's observations: a photograph averaged over cells, clipped ones as lower bounds.
#
# The highlight, which may be smaller than a cell of the whole picture, is seen by a patch of cells
# of its own scale.

_PATCH_REACH = 2.0  # half side of the patch, in half widths of the highlight
_PATCH_WEIGHT = 0.5  # least weight of the patch; that of the whole picture is 1
# Radiance (1 at clipping) above which cells are lower bounds: development compresses bright tones
# below clipping, RAW is linear up to it.
_KNEE_DEVELOPED = 0.8
_ABOVE_KNEE = 0.25  # factor on the residual of a model brighter than such a cell
_HIDDEN = 0.02  # share of cells clipped in all channels above which a highlight may be hidden
# Share of a developed cell's brightest channel added to all of them before the logarithm, as dark
# channels of saturated colours are clipped by the colour space.
CRUSHED = 0.02


@dataclass(frozen=True)
class CoarseCells:
    """Averages of the photograph over n cells."""

    image: Doubles
    """(2, n) image coordinates of the cells."""
    observed: Doubles
    """(3, n) log radiance."""
    toe: Doubles
    """(3, n) radiance added to cell and model before logarithms, as darker values are uncertain."""
    above: Doubles
    """(3, n) factor on the residual of a model brighter than the cell: 1, or less for a bound."""
    weight: Doubles
    """(n,) weight of each cell; they sum to 1/3."""

    @property
    def hidden(self) -> bool:
        """Whether clipped cells may hide a highlight."""
        return float(self.weight[(self.above == 0.0).all(0)].sum()) > _HIDDEN / 3.0

    def differences(self, log_radiance: Linear) -> Linear:
        """(3, n) log radiance of a model less that of the cells, with toe."""
        radiance = np.exp(log_radiance.value)
        raised = radiance + self.toe
        return Linear(np.log(raised) - self.observed, log_radiance.by * (radiance / raised))


def cells_of(
    photo: Photo, highlight: Highlight | None, across: int, patch_across: int
) -> CoarseCells:
    """Cells of the whole photograph; over the highlight's patch, fine ones replace the coarse.

    Args:
        photo: of any size.
        highlight: None without a patch.
        across: cells across the long side.
        patch_across: cells across the patch.
    """
    rows, columns = photo.pixels.shape[:2]
    pixel = 2.0 / columns
    across = min(across, columns)
    size = (across, max(4, round(across * rows / columns)))
    whole = _averaged(photo, (0, 0, columns, rows), size)
    if not whole.weight.any():
        # Every cell has masked pixels: the mask is so fine that its fill is from nearby.
        photo = replace(photo, left_out=None)
        whole = _averaged(photo, (0, 0, columns, rows), size)
    if highlight is None:
        return whole
    reach = _PATCH_REACH * highlight.width
    u, v = highlight.centre
    left, right = (round((u + side + 1.0) / pixel) for side in (-reach, reach))
    top, bottom = (round((rows / columns - v + side) / pixel) for side in (-reach, reach))
    left, top, right, bottom = max(0, left), max(0, top), min(columns, right), min(rows, bottom)
    if right - left < 4 or bottom - top < 4:
        return whole
    fine = patch_across / (2.0 * reach / pixel)
    wide, high = (min(side, max(4, round(fine * side))) for side in (right - left, bottom - top))
    patch = _averaged(photo, (left, top, right, bottom), (wide, high))
    x, y = whole.image
    above, below = (rows / columns - edge * pixel for edge in (top, bottom))
    outside = (x < left * pixel - 1.0) | (x > right * pixel - 1.0) | (y > above) | (y < below)
    if not outside.any():
        return patch
    share = float(outside.mean())
    patch = replace(patch, weight=patch.weight * max(1.0 - share, _PATCH_WEIGHT))
    pairs = ((getattr(whole, one.name), getattr(patch, one.name)) for one in fields(CoarseCells))
    return CoarseCells(*(np.concatenate([all_[..., outside], fine_], -1) for all_, fine_ in pairs))


def _averaged(photo: Photo, box: tuple[int, int, int, int], size: tuple[int, int]) -> CoarseCells:
    """A rectangle (left, top, right, bottom) of a photograph, blurred to (width, height) cells."""
    left, top, right, bottom = box
    rows, columns = photo.pixels.shape[:2]
    small = area_averaged(photo.pixels[top:bottom, left:right], size).astype(np.float64)
    full = photo.full[top:bottom, left:right]
    clipped = area_averaged(full.astype(np.float32), size) > MOST_LEFT_OUT
    knee = FULL if photo.radiometric or photo.floating else _KNEE_DEVELOPED
    knee *= photo.headroom
    above = np.where(clipped, 0.0, np.where(small > knee, _ABOVE_KNEE, 1.0))
    if photo.radiometric:
        above = np.where(above < 1.0, 0.0, 1.0)
    toe = np.full_like(small, 1e-3 * float(np.median(photo.pixels[::8, ::8])) + 1e-9)
    if not photo.radiometric:
        toe += CRUSHED * small.max(axis=2, keepdims=True)
    u = (left + (np.arange(size[0]) + 0.5) * (right - left) / size[0]) * 2.0 / columns - 1.0
    v = (rows - 2.0 * (top + (np.arange(size[1]) + 0.5) * (bottom - top) / size[1])) / columns
    image = np.stack(np.broadcast_arrays(u[None, :], v[:, None])).reshape(2, -1)
    count = size[0] * size[1]

    def flat(field: Doubles) -> Doubles:
        return np.ascontiguousarray(field.reshape(count, 3).T)

    weight = np.full(count, 1.0 / (3.0 * count))
    if photo.left_out is not None:
        part = photo.left_out[top:bottom, left:right].astype(np.float32)
        kept = area_averaged(part, size).ravel() < MOST_LEFT_OUT
        # The sum of weights is that without a mask, or 0 if no cell is left.
        weight = weight * kept * (count / max(float(kept.sum()), 1.0))
    return CoarseCells(image, flat(np.log(small + toe)), flat(toe), flat(above), weight)
