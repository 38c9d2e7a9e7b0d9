"""Photographs resampled on the exemplar's grid, each with camera and light at every texel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import by_slopes
from matcap.capture.exemplar.octaves import local_mean
from matcap.capture.registration.camera import (
    Doubles,
    PosedCamera,
    grid_points,
    to_pixels,
    transformed,
)
from matcap.capture.registration.register import RegisteredView
from matcap.flash.geometry import OWN, Extent, FlashSetup
from matcap.flash.light import (
    DARKEST,
    DifferentiableLight,
    FlashLight,
    Incident,
    cached_rows,
    log_vignette,
    strips,
)
from matcap.flash.rectify import FINER, planes_of
from matcap.photo.left_out import CLIPPED_SHARE, area_averaged
from matcap.photo.photo import Photo

# Ambient light: its subtraction, and a photograph without flash as a measurement of albedo.
#
# A photograph without flash shows albedo under nearly uniform light. With known exposures it is
# subtracted from the flash photographs (as the pair of [aittala2015]). As ambient light varies
# slowly over the sample, the high frequencies of this photograph measure albedo.

Picture = NDArray[np.float32]
Views = tuple[RegisteredView, ...]  # at most one without flash, the last

# Model of ambient light; docs/notes/several.md.
AMBIENT_NOISE = 0.05  # standard deviation of log radiance from the model of ambient light
# Standard deviation of the low-pass that separates illumination, as a share of the long side.
SLOW = 0.08
UNIFORM_SKY = (0.0, 0.0, 0.5)  # prior mean of AmbientLight.gradient
GRADIENT_DEVIATION = 0.25  # prior standard deviation of its x and y
_DARKEST = 0.05  # least irradiance of any normal, over that of a level surface
_FAINTEST = 0.05  # least share of a pixel's radiance that remains after subtraction
_BOUND = 0.005  # share of pixels that may be darker than under ambient light alone


@dataclass(frozen=True)
class AmbientIncidence(Incident):
    """Ambient light incident on a relief: L = (diffuse albedo + F0) E."""

    irradiance: Tensor
    """(1 or 3, h, w) E."""

    def matte(self, albedo: Tensor) -> Tensor:
        """The albedo itself."""
        return albedo

    def mirrored(self, specular: Tensor, roughness: Tensor) -> Tensor:
        """F0 itself, with the shape of both."""
        return specular + 0.0 * roughness


@dataclass(frozen=True)
class AmbientLight:
    """Ambient light: irradiance as spherical harmonics of first order [ramamoorthi2001].

    E(n) = strength (1 + x n_x + y n_y + z (n_z - 1)), relative to a level surface, n = (0, 0, 1).
    """

    gradient: Tensor = field(default_factory=lambda: torch.tensor(UNIFORM_SKY))
    """(3,) x, y and z; (0, 0, 0.5) under a uniform sky."""
    strength: Tensor = field(default_factory=lambda: torch.ones(1, 1, 1))
    """(1 or 3, 1, 1) irradiance of a level surface."""

    def onto(self, normal: Tensor) -> AmbientIncidence:
        """Irradiance of a relief with unit normals (3, h, w)."""
        change = torch.cat([normal[:2], normal[2:] - 1.0])
        irradiance = 1.0 + torch.tensordot(self.gradient.to(change), change, 1)[None]
        return AmbientIncidence(irradiance.clamp_min(_DARKEST) * self.strength)

    def log_gradient(
        self, normal: Tensor, specular: Tensor, roughness: Tensor
    ) -> tuple[AmbientIncidence, Tensor, Tensor]:
        """As DifferentiableLight.log_gradient; of the lobe, only F0 changes the radiance."""
        lit, gradient = self.onto(normal), self.gradient.to(normal)[:, None, None]
        level = lit.irradiance[:1] / self.strength[:1]
        lobe = torch.zeros_like(normal[:1]).repeat(4, 1, 1)
        lobe[0] = 1.0
        return lit, lobe, by_slopes(normal, gradient) / level


def evenly_lit(log: Tensor, seen: Tensor, rendered: Tensor) -> Tensor:
    """Log radiance of an ambient photograph, its low frequencies replaced by those of `rendered`.

    Args:
        log: (3, h, w) log radiance of the photograph.
        seen: (3, h, w) bool, where that is valid.
        rendered: (3, h, w) log radiance of the current maps in uniform ambient light.
    """
    deviation = SLOW * max(log.shape[1:])
    both = zip((log - rendered).numpy(), seen.float().numpy(), strict=True)
    fine = np.stack([plane - local_mean(plane, weight, deviation) for plane, weight in both])
    return rendered + torch.from_numpy(fine)


def without_ambient(views: Views) -> Views:
    """Subtract ambient light from flash photographs.

    Returns the photographs unchanged if none is without flash or an exposure is unknown.
    """
    *lit, ambient = views
    if ambient.flash:
        return views
    cleaned = []
    for view in lit:
        amount = _amount(view.photo, ambient.photo)
        if amount is None:
            return views
        cleaned.append(replace(view, photo=_without(view, ambient, amount)))
    return (*cleaned, ambient)


def _amount(flash: Photo, ambient: Photo) -> NDArray[np.float64] | None:
    """(3,) factor from pixel values of the ambient photograph to those of a flash photograph.

    Ratio of exposures and white balances; None where an exposure is unknown.
    """
    if flash.exposure is None or ambient.exposure is None:
        return None
    balance = np.ones(3)
    if flash.balance is not None and ambient.balance is not None:
        balance = np.array(flash.balance) / np.array(ambient.balance)
    return flash.exposure / ambient.exposure * balance


def _without(view: RegisteredView, ambient: RegisteredView, amount: NDArray[np.float64]) -> Photo:
    """A flash photograph less `amount` times the ambient one; the median share of that is noted."""
    photo = view.photo
    added = _seen_from(view, ambient) * amount.astype(np.float32)
    # No pixel can be darker than under ambient light alone; exposure metadata can be wrong.
    small = (64, round(64 * photo.pixels.shape[0] / photo.pixels.shape[1]))
    total, by_ambient = (area_averaged(each, small) for each in (photo.pixels, added))
    ratio = total / np.maximum(by_ambient, np.float32(1e-6))
    most = np.asarray(np.quantile(ratio.reshape(-1, 3), _BOUND, axis=0)).clip(max=1.0)
    added *= np.asarray(most, np.float32)
    share = float(np.median(added.mean(2) / np.maximum(photo.pixels.mean(2), 1e-6)))
    left = np.maximum(photo.pixels - added, _FAINTEST * photo.pixels)
    # Clipped pixels remain lower bounds.
    left = np.where(photo.full, photo.pixels, left)
    note = (
        f"{100.0 * share:.0f} % of its light was ambient, measured by {ambient.photo.name} and "
        "subtracted."
    )
    return replace(photo, pixels=left, notes=(*photo.notes, note))


def _seen_from(view: RegisteredView, ambient: RegisteredView) -> Picture:
    """(H, W, 3) the ambient photograph resampled to a flash photograph's pixels."""
    rows, columns = view.photo.pixels.shape[:2]
    # Project a coarse grid and interpolate: a camera's projection of a plane is smooth.
    grid = (max(2, rows // 16), max(2, columns // 16))
    v, u = np.meshgrid(*((np.arange(n) + 0.5) / n for n in grid), indexing="ij")
    image = np.stack([2.0 * u - 1.0, (1.0 - 2.0 * v) * rows / columns])
    height, width = ambient.photo.pixels.shape[:2]
    places = to_pixels(ambient.camera.sees(view.camera.on_plane(image)), width, height)
    x, y = (cv2.resize(each, (columns, rows), interpolation=cv2.INTER_LINEAR) for each in places)
    seen = cv2.remap(ambient.photo.pixels, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, np.float32)


RAW_FALLOFF = (1e-3, 1e-3)  # prior standard deviations of the vignetting of RAW photographs
# Least standard deviation of log radiance in one channel of one photograph, model error included.
_NOISE = 0.02
_BORDER = 2.0  # width of a photograph's unused border, pixels


@dataclass(frozen=True)
class SharedLight:
    """Shared light parameters of all photographs, and each one's gains."""

    offset: Tensor
    """(2,) x, y of the flash from the lens, camera frame, plane units."""
    vignetting: Tensor
    """(2,) coefficients of r^2 and r^4 in its exponent (flash/geometry.py)."""
    gain: Tensor
    """(photographs, 3) log of each channel's exposure over the first photograph's."""
    intensity: Tensor
    """(3,) of the first photograph's flash."""
    gloss: Tensor = field(default_factory=lambda: torch.zeros(1, 2))
    """(K, 2 or 4) change of each material's log F0 and logit roughness from the prediction, whose
    error scales all slopes, and of its hue (texels.HUES)."""
    vignetting_deviation: tuple[float, float] = (0.4, 0.6)
    """(2,) prior standard deviations of `vignetting`."""
    ambient: Tensor = field(default_factory=lambda: torch.tensor(UNIFORM_SKY))
    """(3,) gradient of the ambient light (AmbientLight.gradient)."""
    coarse_offset: Tensor = field(default_factory=lambda: torch.zeros(2))
    """(2,) `offset` by the first photograph's coarse fit, the mean of its prior."""
    centre: tuple[float, float] = (0.0, 0.0)
    """Point from which r is measured, image coordinates, as the coarse fit has it."""
    colour: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Added to the coefficient of r^2 by channel, as the coarse fit has it."""

    @staticmethod
    def of(setup: FlashSetup, count: int, *, radiometric: bool = False) -> SharedLight:
        """Initial light of `count` photographs, all RAW (`radiometric`) or all developed."""
        offset = torch.tensor(setup.offset[:2]).float()
        return SharedLight(
            offset,
            torch.tensor([setup.vignetting, setup.vignetting_quartic]),
            torch.zeros(count, 3),
            torch.tensor(setup.intensity).float(),
            vignetting_deviation=RAW_FALLOFF if radiometric else SharedLight.vignetting_deviation,
            coarse_offset=offset,
            centre=setup.vignetting_centre,
            colour=setup.vignetting_colour,
        )

    def onto(self, setup: FlashSetup) -> FlashSetup:
        """The first photograph's setup with this offset, vignetting and intensity."""
        x, y = self.offset.tolist()
        lost, more = self.vignetting.tolist()
        offset = x, y, setup.offset[2]
        setup = replace(setup, offset=offset, vignetting=lost, vignetting_quartic=more)
        red, green, blue = self.intensity.tolist()
        return setup.with_intensity((red, green, blue))

    def of_some(self, kept: Sequence[int]) -> SharedLight:
        """Light of a subset of the photographs; kept[0] becomes the first."""
        gain = self.gain[list(kept)]
        return replace(self, gain=gain - gain[:1], intensity=self.intensity * gain[0].exp())


@dataclass(frozen=True)
class ViewWarp:
    """Map from texels to the plane points at which a photograph is sampled."""

    homography: Doubles
    """(3, 3) homography of the plane (align.py)."""
    relief: NDArray[np.float32]
    """(h, w) height on any grid, plane units, for parallax; 0 of a flat plane."""
    first: Doubles
    """(3,) position of the first camera: texels lie on its rays."""
    extent: Extent = OWN
    """Extent of the grid."""

    def points(self, across: int, down: int) -> Iterator[NDArray[np.float32]]:
        """(3, rows, across) plane points of a grid's texels, some rows at a time.

        Single precision rounds a pixel's place by a thousandth.
        """
        first, homography = (np.asarray(each, np.float32) for each in (self.first, self.homography))
        relief = cv2.resize(self.relief, (across, down), interpolation=cv2.INTER_LINEAR)
        for rows in strips(down, cached_rows(across)):
            points = np.asarray(grid_points(across, down, self.extent, rows), np.float32)
            points += relief[rows] / first[2] * (first[:, None, None] - points)
            points[:2] = transformed(homography, points[:2])
            yield points


@dataclass(frozen=True)
class ShrunkPicture:
    """A photograph with as many pixels as a grid samples."""

    linear: NDArray[np.float32]
    """(h, w, 3) radiance."""
    clipped: NDArray[np.float32] | None
    """(h, w, 3) share of clipped pixels; None if none is."""

    @staticmethod
    def of(photo: Photo, across: int) -> ShrunkPicture:
        """For a grid of so many texels across."""
        rows, columns = photo.pixels.shape[:2]
        shrink = min(1.0, FINER * across / columns)
        size = (round(columns * shrink), round(rows * shrink))
        full = photo.full.astype(np.float32) if photo.clipped.any() else None
        clipped = None if full is None else area_averaged(full, size)
        return ShrunkPicture(area_averaged(photo.pixels, size), clipped)


@dataclass(frozen=True)
class ResampledView:
    """A photograph resampled on the exemplar's grid."""

    log: Tensor
    """(3, H, W) log radiance."""
    seen: Tensor
    """(3, H, W) bool, by channel: in the picture and not clipped."""
    camera: PosedCamera
    """Pose and lens."""
    flash: bool = True
    """Whether its flash lights it, not ambient light."""
    extent: Extent = OWN
    """Extent of the grid."""
    measured_variance: Tensor | float = 0.0
    """(3, 1, 1) variance of log radiance by channel, of residuals (solve.py); 0 if unknown."""

    @property
    def variance(self) -> Tensor | float:
        """(3, 1, 1) variance of log radiance by channel, or of all; residuals' weight is 1 / it."""
        least = _NOISE**2 if self.flash else _NOISE**2 + AMBIENT_NOISE**2
        if isinstance(self.measured_variance, float):
            return least
        return self.measured_variance.clamp_min(least)

    @staticmethod
    def of(
        view: RegisteredView, picture: ShrunkPicture, across: int, down: int, warp: ViewWarp
    ) -> ResampledView:
        """Resample a registered photograph to a grid of (down, across) texels.

        Args:
            picture: its pixels, for as many texels across.
            across, down: texels.
        """
        finer = FINER if view.photo.pixels.shape[1] >= FINER * across else 1
        size = picture.linear.shape[1::-1]
        # A few rows at a time: whole grids of double precision would need much memory.
        grid = warp.points(across * finer, down * finer)
        parts = [to_pixels(view.camera.sees(points), *size) for points in grid]
        x, y = (np.concatenate(each) for each in zip(*parts, strict=True))
        inside = (x > _BORDER) & (x < size[0] - _BORDER) & (y > _BORDER) & (y < size[1] - _BORDER)

        def gridded(picture: NDArray[np.float32], how: int) -> NDArray[np.float32]:
            resampled = cv2.remap(picture, x, y, how, borderMode=cv2.BORDER_REFLECT_101)
            return area_averaged(resampled, (across, down))

        linear = gridded(picture.linear, cv2.INTER_CUBIC).clip(DARKEST)
        whole = area_averaged(inside.astype(np.float32), (across, down))
        seen = np.repeat(whole[..., None] > 0.99, 3, axis=2)
        if picture.clipped is not None:
            seen &= gridded(picture.clipped, cv2.INTER_LINEAR) <= CLIPPED_SHARE
        log = planes_of(np.log(linear))
        return ResampledView(log, planes_of(seen), view.camera, view.flash, warp.extent)


Resampled = Sequence[ResampledView]


def light_at(
    number: int, view: ResampledView, light: SharedLight, points: Tensor
) -> DifferentiableLight:
    """Light of photograph `number` at plane points (3, h, w)."""
    if not view.flash:
        return AmbientLight(light.ambient, light.gain[number].exp()[:, None, None])
    place = torch.from_numpy(view.camera.place).to(points)
    turn = torch.from_numpy(view.camera.turn).to(points)
    flash = place + turn.T @ torch.cat([light.offset, light.offset.new_zeros(1)]).to(points)
    image, (squared, quartic) = _in_image(view, light, points), light.vignetting
    lost = torch.stack([log_vignette(image, squared + more, quartic) for more in light.colour])
    strength = (light.intensity.log() + light.gain[number]).to(points)
    return FlashLight.between(points, place, flash, (strength[:, None, None] + lost).exp())


def by_vignetting(view: ResampledView, light: SharedLight, points: Tensor) -> Tensor:
    """(2, h, w) derivatives of log radiance at plane points (3, h, w) by SharedLight.vignetting."""
    if not view.flash:
        return points.new_zeros(2, *points.shape[1:])
    image = _in_image(view, light, points)
    return torch.stack([log_vignette(image, 1.0, 0.0), log_vignette(image, 0.0, 1.0)])


def _in_image(view: ResampledView, light: SharedLight, points: Tensor) -> Tensor:
    """(2, h, w) image coordinates of plane points (3, h, w), from the vignetting's centre."""
    camera = view.camera
    turn, place = (torch.from_numpy(each).to(points) for each in (camera.turn, camera.place))
    in_camera = torch.tensordot(turn, points - place[:, None, None], dims=1)
    image = camera.lens.focal * in_camera[:2] / -in_camera[2:]
    return image - image.new_tensor(light.centre)[:, None, None]
