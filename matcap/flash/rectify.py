"""Plane: a photograph resampled on the sample's plane by homography, with validity and noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.files.threads import at_once
from matcap.flash.geometry import Extent, FlashSetup, Margins, setup_rotation
from matcap.photo.left_out import CLIPPED_SHARE, area_averaged
from matcap.photo.photo import Photo
from matcap.statistics.compare import Encoding, fit_encoding

# Rectification: a photograph resampled on the plane's grid by homography, viewed from above.
#
# A texel is an area average. To keep sharpness, the photograph is resampled on a finer grid with
# cubic interpolation and then averaged over texels; downsampling before a subpixel shift would lose
# half of the amplitude of the finest texture.

FINER = 2  # samples along the side of a texel, if the photograph has more pixels than texels
_CACHED = 16  # rows of a grid whose float64 coordinates fit the processor's cache
MOST_LEFT_OUT = 0.02  # largest masked share of a valid texel, and largest clipped one of a cell


def rectify(photo: Photo, setup: FlashSetup, detail: int) -> tuple[Tensor, Tensor]:
    """Resample a photograph to the plane rectangle x in [-1, 1]; radiance is not changed.

    Args:
        setup: its geometry; only field of view and tilt matter here.
        detail: texels along the long side.

    Returns:
        linear (3, H, W) float32 and valid (H, W) bool: inside of the photograph and not clipped.
    """
    linear = _resampled(photo.pixels, setup, detail, cv2.INTER_CUBIC).clip(0.0)
    clipped = _resampled(photo.clipped.astype(np.float32), setup, detail, cv2.INTER_LINEAR)
    valid = inside(linear.shape[:2], setup) & (clipped < CLIPPED_SHARE)
    valid &= kept(photo, setup, detail)
    return planes_of(linear), torch.from_numpy(valid)


def kept(photo: Photo, setup: FlashSetup, detail: int) -> NDArray[np.bool_]:
    """(H, W) bool, texels wholly within the material's mask; (1, 1) True without a mask."""
    if photo.left_out is None:
        return np.ones((1, 1), np.bool_)
    share = _resampled(photo.left_out.astype(np.float32), setup, detail, cv2.INTER_LINEAR)
    return np.asarray(share < MOST_LEFT_OUT)


def _resampled(
    picture: NDArray[np.float32], setup: FlashSetup, detail: int, how: int
) -> NDArray[np.float32]:
    """Resample a picture to the plane's grid, (H, W) or (H, W, 3); cubic may overshoot."""
    rows, columns = picture.shape[:2]
    finer = FINER if columns > detail else 1
    fine = (finer * detail, finer * round(detail * rows / columns))
    shrunk = picture
    if columns > fine[0]:
        shrunk = area_averaged(picture, fine)
    seen = cv2.warpPerspective(
        shrunk,
        _homography(setup, fine, (shrunk.shape[1], shrunk.shape[0])),
        fine,
        flags=how | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REFLECT_101,
    )
    size = (detail, fine[1] // finer)
    return area_averaged(seen, size)


def inside(shape: tuple[int, ...], setup: FlashSetup) -> NDArray[np.bool_]:
    """(H, W) bool, texels inside of the picture; `rectify` mirrors the others at its border."""
    height, width = shape
    column, row = np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)[:, None]
    homography = _homography(setup, (width, height), (width, height))

    def some(rows: NDArray[np.float64]) -> NDArray[np.bool_]:
        x, y, w = (a * column + (b * rows + c) for a, b, c in homography)
        return (x > -0.5 * w) & (x < (width - 0.5) * w) & (y > -0.5 * w) & (y < (height - 0.5) * w)

    return np.concatenate([some(row[top : top + _CACHED]) for top in range(0, height, _CACHED)])


def _homography(
    setup: FlashSetup, plane: tuple[int, int], picture: tuple[int, int]
) -> NDArray[np.float64]:
    """(3, 3) from texels of a plane's grid to pixels of a picture, (column, row, 1) both.

    `geometry.project` in homogeneous coordinates; sizes are (width, height).
    """
    turn = setup_rotation(setup, torch.float64).numpy()
    projected = np.array(
        [
            [setup.distance * turn[0, 0], setup.distance * turn[0, 1], 0.0],
            [setup.distance * turn[1, 0], setup.distance * turn[1, 1], 0.0],
            [-turn[2, 0], -turn[2, 1], setup.distance],
        ]
    )
    return _centred(picture) @ projected @ np.linalg.inv(_centred(plane))


def _centred(size: tuple[int, int]) -> NDArray[np.float64]:
    """(3, 3) from coordinates whose long side is [-1, 1], y upwards, to a grid's (column, row)."""
    width, height = size
    return np.array(
        [
            [width / 2.0, 0.0, width / 2.0 - 0.5],
            [0.0, -width / 2.0, height / 2.0 - 0.5],
            [0.0, 0.0, 1.0],
        ]
    )


def planes_of(picture: NDArray[Any]) -> Tensor:
    """(H, W, C) to (C, H, W)."""
    return torch.from_numpy(picture).permute(2, 0, 1).contiguous()


def picture_of(planes: Tensor) -> NDArray[np.float32]:
    """(C, H, W) to (H, W, C)."""
    picture: NDArray[np.float32] = planes.permute(1, 2, 0).contiguous().numpy()
    return picture


# Plane: a photograph rectified to the sample's plane, with validity and noise.


@dataclass(frozen=True)
class Plane:
    """A rectified photograph."""

    linear: Tensor
    """(3, H, W) scene-linear picture with its shading."""
    valid: Tensor
    """(H, W) bool, texels inside of the photograph and not clipped."""
    noise: Tensor | None
    """(3, H, W) a sample of the sensor noise model, in the picture's units, or None if unknown."""
    encoding: Encoding
    """Colour space in which its texture is compared."""
    channels: Tensor | None = None
    """(3, H, W) bool, the same by channel; None for `valid` in all channels."""
    left_out: Tensor | None = None
    """(H, W) bool, texels masked or outside of the photograph, filled by mirrored ones, or None."""
    developed: bool = False
    """Whether the picture is developed (8-bit codes), not RAW or floating-point."""
    margins: Margins = Margins()
    """Margins of a mosaic's grid around the photograph's own."""

    @property
    def measured(self) -> Tensor:
        """(3, H, W) bool: where each channel is a measurement, not a bound."""
        if self.channels is None:
            return self.valid.expand(3, -1, -1)
        return self.channels | self.valid

    @property
    def kept(self) -> Tensor:
        """(H, W) bool: texels of the material that the photograph shows."""
        return torch.ones_like(self.valid) if self.left_out is None else ~self.left_out

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in texels."""
        return self.linear.shape[-1], self.linear.shape[-2]

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units: the width spans x in [-1, 1]."""
        return self.extent.texel(self.linear.shape[-1])

    @property
    def extent(self) -> Extent:
        """Extent of its grid on the plane."""
        return self.margins.extent(self.linear.shape[-1] - self.margins.left - self.margins.right)

    @property
    def unit(self) -> float:
        """Texels along the photograph's long side, of which a mosaic has more."""
        return self.extent.unit(self.linear.shape[-1])

    def encoded(self) -> Tensor:
        """(3, H, W) texture colour of about unit variance, shading included."""
        return self.encoding(self.linear[None])[0]

    def shrunk(self, columns: int) -> Plane:
        """Area average on a coarser grid, `columns` texels across."""
        width, height = self.size
        size = [max(1, round(height * columns / width)), columns]

        def mean(planes: Tensor) -> Tensor:
            return F.interpolate(planes[None], size=size, mode="area")[0]

        def whole(seen: Tensor) -> Tensor:
            return mean(seen.float()) > 1.0 - CLIPPED_SHARE

        linear, valid = mean(self.linear), whole(self.valid[None])[0]
        noise = None if self.noise is None else mean(self.noise)
        left_out = None if self.left_out is None else ~whole(~self.left_out[None])[0]
        shrunk = plane_of(linear, valid, noise, self.encoding.limit)
        channels = whole(self.measured)
        return replace(shrunk, channels=channels, left_out=left_out, developed=self.developed)

    def over(self, margins: Margins, known: Tensor) -> Plane:
        """The plane padded to the grid of a mosaic, invalid beyond its own texels.

        Args:
            known: (H, W) bool on the mosaic; texels that are not known are masked.
        """

        def padded(planes: Tensor) -> Tensor:
            pad = (margins.left, margins.right, margins.top, margins.bottom)
            return F.pad(planes[None], pad, mode="replicate")[0]

        return replace(
            self,
            linear=padded(self.linear),
            valid=margins.padded(self.valid),
            noise=None if self.noise is None else padded(self.noise),
            channels=margins.padded(self.measured),
            left_out=~known,
            margins=margins,
        )


def read_plane(photo: Photo, setup: FlashSetup, detail: int) -> Plane:
    """Rectify a photograph to the plane's grid.

    Args:
        setup: its geometry; only field of view and tilt matter here.
        detail: texels along the long side.
    """

    def noisy() -> Tensor | None:
        if photo.noise is None:
            return None
        return planes_of(_resampled(photo.noise, setup, detail, cv2.INTER_CUBIC))

    def bounded() -> NDArray[np.float32]:
        return _resampled(photo.full.astype(np.float32), setup, detail, cv2.INTER_LINEAR)

    (linear, valid), noise, full = at_once(partial(rectify, photo, setup, detail), noisy, bounded)
    shown = inside(valid.shape, setup) & kept(photo, setup, detail)
    return replace(
        plane_of(linear, valid, noise, photo.headroom),
        # A sparkle clipped in red can still be valid in green and blue.
        channels=planes_of(shown[..., None] & (full < CLIPPED_SHARE)),
        left_out=None if shown.all() else torch.from_numpy(~shown),
        developed=not (photo.radiometric or photo.floating),
    )


def plane_of(
    linear: Tensor, valid: Tensor, noise: Tensor | None = None, headroom: float = 1.0
) -> Plane:
    """Plane of a rectified picture that clips at `headroom`, with its own encoding."""
    return Plane(linear, valid, noise, fit_encoding(linear, valid, noise, headroom))
