"""Rays of a camera: pixel centres to lines through the scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from matcap.relight.scene import Camera, Film
from matcap.relight.vectors import Array, unit3

Points = Array
# Of a 4:3 picture's corner, whose long side is in [-1, 1]: where vignetting is stated.
_CORNER_SQUARED = 1.25**2


@dataclass(frozen=True)
class View:
    """A camera and the picture it takes."""

    position: Points
    """(3,) place of a perspective camera."""
    axes: Points
    """(3, 3) rows right, up and forward."""
    reach: float
    """Half the picture's long side at distance 1 (perspective) or in plane units."""
    size: tuple[int, int]
    """(width, height) in pixels."""
    perspective: bool
    """Whether rays meet in `position`."""
    columns: tuple[int, int] | None = None
    """Half open range of those that rays are asked for; None is all."""
    vignetting: float = 0.0
    vignetting_quartic: float = 0.0
    """See Camera."""

    @property
    def across(self) -> tuple[int, int]:
        """Half open range of the columns that rays are asked for."""
        return self.columns or (0, self.size[0])

    @property
    def pixel(self) -> float:
        """A pixel's side: at distance 1 (perspective) or in plane units."""
        return 2.0 * self.reach / max(self.size)

    def part(self, left: int, right: int) -> View:
        """The view of some columns, half open, of the same picture."""
        return replace(self, columns=(left, right))

    def screen(self, top: int, bottom: int) -> tuple[Array, Array]:
        """(1, W) and (bottom - top, 1): places of pixel centres, in units of `reach`."""
        width, height = self.size
        half = max(width, height) / 2.0
        across = (np.arange(*self.across) + 0.5 - width / 2.0) / half * self.reach
        down = (height / 2.0 - np.arange(top, bottom) - 0.5) / half * self.reach
        return across[None, :], down[:, None]

    def share(self, top: int, bottom: int) -> Array:
        """(bottom - top, W) share of the light of rows of pixels that the lens lets through."""
        across, down = (c / self.reach for c in self.screen(top, bottom))
        squared = (across * across + down * down) / _CORNER_SQUARED
        exponent = squared * (self.vignetting + self.vignetting_quartic * squared)
        share: Array = np.exp(-exponent).astype(np.float32)
        return share

    @property
    def vignetted(self) -> bool:
        """Whether the lens loses any light."""
        return self.vignetting != 0.0 or self.vignetting_quartic != 0.0

    @property
    def brightest(self) -> float:
        """By how much at most the lens brightens a picture."""
        width, height = self.size
        corner = (1.0 + (min(width, height) / max(width, height)) ** 2) / _CORNER_SQUARED
        first, second = self.vignetting, self.vignetting_quartic
        # Of a parabola between the middle and a corner: at one of them, or at its turn.
        turn = -0.5 * first / second if second else 0.0
        places = (0.0, corner, min(max(turn, 0.0), corner))
        return max(math.exp(-s * (first + second * s)) for s in places)

    def rays(self, top: int, bottom: int) -> tuple[Array, Array]:
        """Origins and unit directions of the rows' rays, (3, bottom - top, W) each."""
        across, down = self.screen(top, bottom)
        across, down = np.broadcast_arrays(across, down)
        right, up, forward = (axis[:, None, None] for axis in self.axes)
        offset = right * across + up * down
        place = self.position[:, None, None]
        if self.perspective:
            direction = forward + offset
            length = np.sqrt((direction * direction).sum(axis=0))
            return np.broadcast_to(place, offset.shape), direction / length
        return place + offset, np.broadcast_to(forward, offset.shape)


def view_of(camera: Camera | None, film: Film, long_side: float) -> View:
    """The view of a camera, or of the photograph's where there is none.

    The photograph's camera looks straight down from where its 45 degrees frame `long_side`.
    """
    size = (film.width, film.height)
    if camera is None:
        reach = math.tan(math.radians(22.5))
        place = np.array([0.0, 0.0, long_side / 2.0 / reach])
        return View(place, np.diag([1.0, 1.0, -1.0]), reach, size, True)
    place = np.asarray(camera.position, dtype=np.float64)
    forward = unit3(tuple(np.asarray(camera.target) - place))
    upright = unit3(camera.up)
    # Looking along `up`, the picture's top is where the scene's front is.
    if abs(forward @ upright) >= 1.0 - 1e-9:
        upright = np.array([0.0, 0.0, -1.0])
    right = np.cross(forward, upright)
    right = right / np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, forward), forward])
    if camera.type == "perspective":
        reach = math.tan(math.radians(camera.fov / 2.0))
    else:
        reach = camera.scale
    perspective = camera.type == "perspective"
    return View(
        place,
        axes,
        reach,
        size,
        perspective,
        vignetting=camera.vignetting,
        vignetting_quartic=camera.vignetting_quartic,
    )
