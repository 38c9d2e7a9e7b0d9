"""Blend mask: a grey image stretched over a rectangle of the plane."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.errors import UsageError
from matcap.field.blocks import check_rectangle
from matcap.field.plane import Period, Rectangle, Span
from matcap.files.mask import read_mask as read_shares


@dataclass(frozen=True)
class Mask:
    """A share in [0, 1] for every texel of the plane, bilinear between pixels."""

    pixels: NDArray[Any]
    """(H, W) uint8 or uint16; 0 is share 0, the type's maximum is share 1."""
    over: Rectangle
    """Rectangle of the plane that the image is stretched over. Outside, the border pixels are
    extended; along an axis with a period the image repeats."""
    period: Period | None = None
    """Period in texels; along an axis with a period `over` is exactly as long."""

    def shares(self, x: int, y: int, rows: Span, columns: Span) -> Tensor:
        """(rows, columns) float32 shares at texel centres.

        Args:
            x, y: texel of the plane at which the spans have their zero.
            rows, columns: spans of texels.
        """
        along_x, along_y = self.period or (None, None)
        height, width = self.pixels.shape
        left, right, from_right = _neighbours(
            x - self.over.x, columns, width, self.over.width, along_x
        )
        top, bottom, from_bottom = _neighbours(
            y - self.over.y, rows, height, self.over.height, along_y
        )
        scale = float(np.iinfo(self.pixels.dtype).max)
        upper, lower = (
            self.pixels[line][:, left] * (1.0 - from_right)
            + self.pixels[line][:, right] * from_right
            for line in (top, bottom)
        )
        share = upper * (1.0 - from_bottom[:, None]) + lower * from_bottom[:, None]
        return torch.from_numpy((share / scale).astype(np.float32))


def read_mask(path: Path, over: Rectangle, period: Period | None = None) -> Mask:
    """Read a mask from an image file; files/mask.py defines how colours and alpha become shares.

    Raises:
        MatcapError: the file is missing or cannot be read as a mask.
        UsageError: an empty rectangle, or a side other than the period.
    """
    check_rectangle(over)
    for length, side in zip(period or (), (over.width, over.height), strict=False):
        if length is not None and length != side:
            raise UsageError(
                f"the mask covers {side} texels of a field that repeats after {length}",
                remedy="stretch it over the whole period",
            )
    whole = np.rint(read_shares(path) * np.float32(65535.0)).astype(np.uint16)
    return Mask(whole, over, period)


def _neighbours(
    start: int, span: Span, pixels: int, length: int, period: int | None
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """For bilinear interpolation along one axis: both pixels and the second one's weight.

    Args:
        start, span: texels, from the rectangle's first.
        pixels: of the image along the axis.
        length: texels that the image is stretched over.
        period: in texels, or None.
    """
    # Twice a texel's centre is an integer, so that positions are exact anywhere.
    twice = 2 * (start + np.arange(span.start, span.stop, dtype=np.int64)) + 1
    if period is not None:
        twice %= 2 * period
    place = twice * (pixels / (2.0 * length)) - 0.5
    before = np.floor(place).astype(np.int64)
    share = place - before
    if period is None:
        return np.clip(before, 0, pixels - 1), np.clip(before + 1, 0, pixels - 1), share
    return before % pixels, (before + 1) % pixels, share
