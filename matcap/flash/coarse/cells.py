"""The coarse fit's model and observations: cells, uniform material, camera and flash."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import Reflectance
from matcap.flash.highlight import Highlight
from matcap.flash.light import FlashLight, log_vignette
from matcap.flash.rectify import MOST_LEFT_OUT
from matcap.photo.left_out import area_averaged
from matcap.photo.photo import FULL, Photo

# The coarse fit's model: parameters, and log radiance of a uniform material in the camera frame.
#
# With the diffuse albedo a (0.005 F0 of a conductor), roughness r, and E the irradiance of
# flash/light.py,
#
# log L = log(a E / pi + specular(F0, r) E) - vignetting.

_DARKEST = 1e-12  # radiance added before logarithms
_OUTSIDE = 0.1  # of the largest channel of albedo, by which the least may be below 0
BLACK = 0.005  # diffuse albedo of a conductor over its F0


@dataclass(frozen=True)
class Unknowns:
    """The fitted parameters, scaled to order 1."""

    albedo: Tensor
    """(3,) log of diffuse albedo; of a conductor, log of F0."""
    specular: Tensor
    """(1,) log of a dielectric's F0."""
    roughness: Tensor
    """(1,) logit."""
    intensity: Tensor
    """(1,) log of the flash's, in green."""
    flash_colour: Tensor
    """(2,) log of the flash's intensity in red and in blue over that."""
    offset: Tensor
    """(2,) of the flash from the camera, plane units."""
    tilt: Tensor
    """(2,) radians."""
    vignetting: Tensor
    """(2,) with r^2 and with r^4, as FlashSetup has them."""
    centre: Tensor
    """(2,) of the vignetting, image coordinates."""
    tone: Tensor
    """(1,) log of the tone curve's exponent."""

    def vector(self) -> Tensor:
        """(17,) all of them."""
        return torch.cat([getattr(self, f.name) for f in fields(self)])

    @staticmethod
    def of(vector: Tensor) -> Unknowns:
        """The inverse of vector()."""
        return Unknowns(*vector.split((3, 1, 1, 1, 2, 2, 2, 2, 2, 1)))

    @property
    def flash(self) -> Tensor:
        """(3,) log of the flash's intensity by channel."""
        red, blue = (self.intensity + self.flash_colour).split(1)
        return torch.cat([red, self.intensity, blue])


COUNT = 17  # of unknowns
INDEX = Unknowns.of(torch.arange(COUNT))  # of each unknown in vector()


def numbers(*values: float) -> Tensor:
    """A float64 vector."""
    return torch.tensor(values, dtype=torch.float64)


def log_radiance(
    unknowns: Unknowns, image: Tensor, distance: float, *, conductor: bool = False
) -> tuple[Tensor, Tensor]:
    """(3, n) log radiance of the uniform material, and (n,) its diffuse share under a white flash.

    Args:
        image: (2, n) image coordinates.
        distance: of the camera, plane units.
        conductor: `albedo` is F0, and hardly anything is diffuse.
    """
    normal, camera, flash = _places(unknowns, distance)
    image = image[:, None]
    # Points where the rays meet the tilted plane.
    ray = torch.cat([image, torch.full_like(image[:1], -distance)])
    along = -(normal[2] * distance) / torch.tensordot(normal, ray, dims=1)
    points = camera[:, None, None] + along * ray
    light = FlashLight.between(points, camera, flash, unknowns.flash.exp()[:, None, None])
    incidence = light.onto(normal[:, None, None].expand_as(points), exact=True)
    albedo = unknowns.albedo.exp() if conductor else signed_albedo(unknowns.albedo)
    colour = albedo[:, None, None]
    surface = Reflectance(
        colour * (BLACK if conductor else 1.0),
        colour if conductor else unknowns.specular.exp()[:, None, None],
        torch.sigmoid(unknowns.roughness)[:, None, None],
    )
    lost = log_vignette(image - unknowns.centre[:, None, None], *unknowns.vignetting)
    matte, mirrored = incidence.matte(surface.diffuse), incidence.mirrored(*surface[1:])
    radiance = ((matte + mirrored) * incidence.irradiance).clamp_min(0.0)
    share = matte.mean(0) / (matte + mirrored).mean(0).clamp_min(_DARKEST)
    return ((radiance + _DARKEST).log() + lost).flatten(1), share.flatten()


def signed_albedo(log: Tensor) -> Tensor:
    """(3,) diffuse albedo of its unknown; of a colour outside sRGB the least channel is negative.

    A file clips it at 0 except under the highlight, where it darkens the channel. With a positive
    one, the flash would take that colour: pink, of a blue paint.
    """
    positive = log.exp()
    return positive - _OUTSIDE * (positive.max() - positive)


def mirror_point(unknowns: Unknowns, distance: float) -> Tensor:
    """(2,) image coordinates of the mirror point."""
    normal, camera, light = _places(unknowns, distance)
    height_camera, height_light = (normal * camera).sum(), (normal * light).sum()
    foot_camera, foot_light = camera - height_camera * normal, light - height_light * normal
    point = foot_camera * height_light + foot_light * height_camera
    point = point / (height_camera + height_light)
    return point[:2] * (distance / (distance - point[2]))


def _places(unknowns: Unknowns, distance: float) -> tuple[Tensor, Tensor, Tensor]:
    """(3,) each, in the camera frame: the plane's normal, places of camera and flash."""
    (sine_x, sine_y), (cosine_x, cosine_y) = unknowns.tilt.sin(), unknowns.tilt.cos()
    normal = torch.stack(
        [sine_y * cosine_x, -sine_x, cosine_y * cosine_x]
    )  # setup_rotation()[:, 2]
    camera = numbers(0.0, 0.0, distance)
    return normal, camera, camera + F.pad(unknowns.offset, (0, 1))


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

    image: Tensor
    """(2, n) image coordinates of the cells."""
    observed: Tensor
    """(3, n) log radiance."""
    toe: Tensor
    """(3, n) radiance added to cell and model before logarithms, as darker values are uncertain."""
    above: Tensor
    """(3, n) factor on the residual of a model brighter than the cell: 1, or less for a bound."""
    weight: Tensor
    """(n,) weight of each cell; they sum to 1/3."""

    @property
    def hidden(self) -> bool:
        """Whether clipped cells may hide a highlight."""
        return float(self.weight[(self.above == 0.0).all(0)].sum()) > _HIDDEN / 3.0

    def differences(self, log_radiance: Tensor) -> Tensor:
        """(3, n) log radiance of a model less that of the cells, with toe."""
        return (log_radiance.exp() + self.toe).log() - self.observed


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
    share = float(outside.double().mean())
    patch = replace(patch, weight=patch.weight * max(1.0 - share, _PATCH_WEIGHT))
    pairs = ((getattr(whole, one.name), getattr(patch, one.name)) for one in fields(CoarseCells))
    return CoarseCells(*(torch.cat([all_[..., outside], fine_], dim=-1) for all_, fine_ in pairs))


def _averaged(photo: Photo, box: tuple[int, int, int, int], size: tuple[int, int]) -> CoarseCells:
    """A rectangle (left, top, right, bottom) of a photograph, blurred to (width, height) cells."""
    left, top, right, bottom = box
    rows, columns = photo.pixels.shape[:2]
    pixels = photo.pixels[top:bottom, left:right]
    small = area_averaged(pixels, size).astype(np.float64)
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

    def flat(field: NDArray[np.float64]) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(field.reshape(count, 3).T))

    weight = torch.full((count,), 1.0 / (3.0 * count), dtype=torch.float64)
    if photo.left_out is not None:
        part = photo.left_out[top:bottom, left:right].astype(np.float32)
        share = area_averaged(part, size).ravel()
        kept = torch.from_numpy(share < MOST_LEFT_OUT).double()
        # The sum of weights is that without a mask, or 0 if no cell is left.
        weight = weight * kept * (count / max(float(kept.sum()), 1.0))
    log = flat(np.log(small + toe))
    return CoarseCells(torch.from_numpy(image), log, flat(toe), flat(above), weight)
