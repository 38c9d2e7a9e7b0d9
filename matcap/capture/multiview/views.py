"""Photographs resampled on the exemplar's grid, each with camera and light at every texel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.capture.multiview.ambient_light import AMBIENT_NOISE, UNIFORM_SKY, AmbientLight
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
    cached_rows,
    log_vignette,
    strips,
)
from matcap.flash.rectify import FINER, planes_of
from matcap.photo.left_out import CLIPPED_SHARE, area_averaged
from matcap.photo.photo import Photo

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
            view: the photograph.
            picture: its pixels, for as many texels across.
            across, down: texels.
            warp: map to plane points.
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
        return ResampledView(
            planes_of(np.log(linear)), planes_of(seen), view.camera, view.flash, warp.extent
        )


def light_at(
    number: int, view: ResampledView, light: SharedLight, points: Tensor
) -> DifferentiableLight:
    """Light of photograph `number` at plane points (3, h, w)."""
    if not view.flash:
        return AmbientLight(light.ambient, light.gain[number].exp()[:, None, None])
    place = torch.from_numpy(view.camera.place).to(points)
    turn = torch.from_numpy(view.camera.turn).to(points)
    flash = place + turn.T @ torch.cat([light.offset, light.offset.new_zeros(1)]).to(points)
    lost = log_vignette(_in_image(view, light, points), light.vignetting[0], light.vignetting[1])
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
