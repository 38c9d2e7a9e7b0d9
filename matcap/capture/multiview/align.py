"""Registration to a tenth of a texel, by rendering the maps for each photograph.

Feature matches are accurate to half a pixel, and shift with relief and light. So the maps are
estimated on coarse to fine grids and every photograph but the first is warped by the homography
that minimises the residual of log radiance, texel parameters eliminated (shared.py), parallax of
the relief included. The error on a grid is a fraction of a texel, but a whole period for threads of
a few texels: a photograph with a smaller error by features is not moved on that grid.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.octaves import smoothed
from matcap.capture.multiview.shared import shared_step
from matcap.capture.multiview.surface import integrated
from matcap.capture.multiview.texels import (
    SLOPES,
    Estimate,
    ParameterPrior,
    stepped,
    under_fitted_ambient,
)
from matcap.capture.multiview.views import (
    Resampled,
    ResampledView,
    SharedLight,
    ShrunkPicture,
    ViewWarp,
)
from matcap.capture.registration.camera import (
    Doubles,
    Pair,
    PosedCamera,
    adjust,
    grid_points,
    to_pixels,
    transformed,
)
from matcap.capture.registration.register import RegisteredView
from matcap.flash.geometry import OWN, Extent, FlashSetup

# Settings of the registration by rendering; larger grids are more accurate and slower.

# Texels across of the grids, coarse to fine, as shares of the exemplar's.
_LEVELS = (0.25, 0.5, 1.0)
_FINEST = 768  # most texels across
_ROUNDS = (3, 4, 4)  # most registration rounds on each grid
_SETTLED = 0.1  # texels; a grid ends when no photograph is moved farther in a round
# Gauss-Newton steps per texel on each grid, for the relief's parallax; on the finest only the
# sampled texels move.
_STEPS = (2, 1, 0)
_SLOW = 0.06  # standard deviation of the Gaussian high-pass of heights, as a share of the long side
_PIXEL = 1e-3  # expected registration error by features, plane units
# Factor on the cameras' standard deviations by features: rendering removes their main error, which
# is shading (docs/notes/several.md).
_REMAINING = 0.5
# Texels: a photograph with a smaller registration error by features is not moved on a grid.
_CERTAIN = 0.25


@dataclass(frozen=True)
class Aligned:
    """Photographs registered to each other."""

    setup: FlashSetup
    """Camera and flash of the first photograph, with the estimated tilt and field of view."""
    views: tuple[RegisteredView, ...]
    """Photographs with their cameras, the first one first."""
    light: SharedLight
    """Light that all photographs share."""
    homographies: tuple[Doubles, ...]
    """(3, 3) correction of each photograph's registration, a homography of the plane."""
    relief: NDArray[np.float32]
    """(h, w) height on any grid, plane units, for parallax; 0 of a flat plane."""
    extent: Extent = OWN
    """Extent of the exemplar on the plane."""

    @staticmethod
    def of(views: tuple[RegisteredView, ...], setup: FlashSetup, extent: Extent = OWN) -> Aligned:
        """Registration by features alone, with the light of the first photograph's coarse fit."""
        raw = all(view.photo.radiometric for view in views)
        light = SharedLight.of(setup, len(views), radiometric=raw)
        homographies = (np.eye(3),) * len(views)
        return Aligned(setup, views, light, homographies, np.zeros((1, 1), np.float32), extent)

    @property
    def warps(self) -> list[ViewWarp]:
        """Map of each photograph from texels to the plane points at which it is sampled."""
        first = self.views[0].camera.place
        return [ViewWarp(each, self.relief, first, self.extent) for each in self.homographies]

    def pictures(self, across: int) -> list[ShrunkPicture]:
        """Every photograph's pixels, for a grid of so many texels across."""
        return [ShrunkPicture.of(view.photo, across) for view in self.views]

    def on_grid(
        self, across: int, down: int, pictures: Sequence[ShrunkPicture] | None = None
    ) -> list[ResampledView]:
        """Resample every photograph, given its pictures, to a grid of (down, across) texels."""
        each = zip(self.views, pictures or self.pictures(across), self.warps, strict=True)
        return [ResampledView.of(view, own, across, down, warp) for view, own, warp in each]


@torch.no_grad()
def aligned(
    by_features: Aligned,
    prediction: Estimate,
    on_progress: Callable[[float], None] = lambda _share: None,
) -> Aligned:
    """Register all photographs to the first by rendering, and refit their cameras.

    Args:
        by_features: registration by features (Aligned.of).
        prediction: the network's, of the first photograph, on the plane of `by_features`.
        on_progress: called with the completed share, in [0, 1].
    """
    # The prediction is on the plane of a lens without distortion.
    alignment, predicted = by_features, PosedCamera.of(by_features.setup)
    parameters: Tensor | None = None
    moved, done = set[int](), 0
    for level, rounds, steps in zip(_LEVELS, _ROUNDS, _STEPS, strict=True):
        small = _on_level(prediction, level, predicted, alignment)
        size, texel, prior = small.maps.size, small.maps.texel_size, ParameterPrior.of(small)
        uncertain = {
            number
            for number, view in enumerate(alignment.views)
            if view.misregistration >= _CERTAIN * texel
        }
        if not uncertain and not steps:
            continue
        pictures = alignment.pictures(size[0])
        views = alignment.on_grid(*size, pictures)
        parameters = _initial(views, parameters, prior, alignment.light, steps)
        relief = _relief(parameters, texel, alignment.extent.unit(size[0]))
        for turn in range(rounds):
            if turn:
                views = alignment.on_grid(*size, pictures)
            lit = under_fitted_ambient(views, parameters, alignment.light)
            light, moves = shared_step(lit, parameters, prior, alignment.light, moved=uncertain)
            both = zip(alignment.homographies, moves, strict=True)
            homographies = tuple(homography @ move for homography, move in both)
            alignment = replace(alignment, homographies=homographies, relief=relief, light=light)
            done += 1
            on_progress(done / (len(_LEVELS) * (1 + max(_ROUNDS))))
            if _farthest(moves) < _SETTLED * texel:
                break
        if uncertain:
            alignment = _posed(by_features.setup, alignment)
            moved |= uncertain
    registered = tuple(
        replace(view, position_deviation=_REMAINING * view.position_deviation)
        if number in moved
        else view
        for number, view in enumerate(alignment.views)
    )
    return replace(alignment, views=registered)


def _on_level(
    prediction: Estimate, level: float, predicted: PosedCamera, alignment: Aligned
) -> Estimate:
    """The prediction on a grid of `level` times the texels, on the plane of the first camera.

    Args:
        prediction: on the plane of the camera `predicted`.
        level: texels over those of the prediction, of which at most _FINEST count.
        predicted: the first photograph's camera at the prediction.
        alignment: has its current camera.
    """
    extent = alignment.extent
    finest = min(extent.unit(prediction.maps.size[0]), _FINEST)
    small = prediction.coarser(max(64, round(level * finest)), extent)
    return replace(small, maps=reframed(small.maps, predicted, alignment.views[0].camera, extent))


def _farthest(moves: Sequence[Doubles]) -> float:
    """Largest displacement by any of the homographies (3, 3), plane units."""
    points = grid_points(8, 6)[:2]
    return max(float(np.abs(transformed(move, points) - points).max()) for move in moves)


def _relief(parameters: Tensor, texel_size: float, unit: float) -> NDArray[np.float32]:
    """(H, W) height for parallax, high-passed: slopes do not determine low frequencies."""
    height = integrated(parameters[SLOPES], texel_size)[0].numpy()
    return height - smoothed(height, _SLOW * unit)


def _initial(
    views: Resampled, coarser: Tensor | None, prior: ParameterPrior, light: SharedLight, steps: int
) -> Tensor:
    """(PARAMETERS, H, W) parameters of a grid, after Gauss-Newton steps.

    Args:
        coarser: parameters of the coarser grid to start from; None to start from the prior mean,
            under a light that is fitted to it.
        light: of the photographs.
    """
    if coarser is not None:
        parameters = F.interpolate(coarser[None], size=prior.mean.shape[1:], mode="bilinear")[0]
    else:
        parameters = prior.mean
        lit = under_fitted_ambient(views, parameters, light)
        light, _ = shared_step(lit, parameters, prior, light)
    lit, prior = under_fitted_ambient(views, parameters, light), prior.with_gloss_of(light)
    for _ in range(steps):
        parameters = stepped(lit, parameters, prior, light).parameters
    return parameters


def _posed(setup: FlashSetup, alignment: Aligned) -> Aligned:
    """Refit the cameras to the homographies of the photographs by bundle adjustment."""
    points = grid_points(12, 9).reshape(3, -1)
    camera, pairs = alignment.views[0].camera, []
    first = camera.sees(points)
    in_first = np.abs(first).max(0) < 1.0
    for view, homography in zip(alignment.views[1:], alignment.homographies[1:], strict=True):
        moved = np.concatenate([transformed(homography, points[:2]), points[2:]])
        image = view.camera.sees(moved)
        both = in_first & (np.abs(image).max(0) < 1.0)
        ratio = view.camera.lens.focal / camera.lens.focal
        pairs.append(Pair(first[:, both], image[:, both], _PIXEL, ratio))
    adjusted = adjust(setup, pairs, known=True, relief=0.0)
    posed = zip(alignment.views, adjusted.cameras, strict=True)
    views = tuple(replace(view, camera=camera) for view, camera in posed)
    homographies = (np.eye(3),) * len(views)
    return replace(alignment, setup=adjusted.first, views=views, homographies=homographies)


def reframed(maps: MapSet, old: PosedCamera, new: PosedCamera, extent: Extent = OWN) -> MapSet:
    """Resample maps from the plane of an earlier estimate of a camera to that of a later one."""
    across, down = maps.size
    points = old.on_plane(new.sees(grid_points(across, down, extent)))
    middle = np.asarray(extent.middle)[:, None, None]
    places = to_pixels((points[:2] - middle) / extent.half, across, down)
    channels = [
        cv2.remap(channel, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
        for channel in maps.stacked().float().numpy()
    ]
    return MapSet.from_stacked(torch.from_numpy(np.stack(channels)), maps.texel_size)
