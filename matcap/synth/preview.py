"""NAME_preview.png: about a megapixel of a map set or texture set, lit from the top.

One pixel a texel, of the middle; where the field repeats, of where its copies meet, with the seam's
place marked outside the picture. Workers light the parts as they compute them (jobs.py), so that
nothing is read back; a resumed run computes the parts that the preview shows again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matcap.field.blocks import BlockPart
from matcap.field.plane import Rectangle
from matcap.files.png import png_bytes, quantised
from matcap.files.srgb import srgb_picture
from matcap.synth.pictures import kind_planes

if TYPE_CHECKING:
    from matcap.brdf.stated import NormalStyle
    from matcap.field.plane import Period

_PIXELS, _SIDE = 1 << 20, 1024  # of the picture; one side is longer if the other is shorter
# Dark materials are multiplied until this quantile of the radiance has this value.
_BRIGHT_SHARE, _BRIGHT, _LARGEST_GAIN = 0.99, 0.5, 4.0
_MARGIN, _PAPER, _INK = 16, 24, (240, 180, 41)  # pixels around what repeats; sRGB code values

# Rows and columns of the picture, and of the part that is shown there.
_Place = tuple[tuple[slice, slice], tuple[slice, slice]]


@dataclass(frozen=True)
class Preview:
    """The rectangle that a preview shows."""

    whole: Rectangle
    """The map set or texture set."""
    shown: Rectangle
    """Texels of the field; beyond `whole` along axes that repeat."""
    repeats: tuple[bool, bool]
    """Whether the field repeats with the whole's sides, along x and y."""

    def places(self, area: Rectangle, part: BlockPart) -> list[_Place]:
        """Where a part of a map set of this area is shown; empty if it is not."""
        rows, columns = part.target
        down = list(self._along(1, area.y + rows.start, rows.stop - rows.start))
        across = list(self._along(0, area.x + columns.start, columns.stop - columns.start))
        return [((y, x), (row, column)) for y, row in down for x, column in across]

    def _along(self, axis: int, start: int, length: int) -> Iterator[tuple[slice, slice]]:
        """Slices of the picture and of `length` texels from `start`, along x (0) or y (1)."""
        shown, whole = (
            ((one.x, one.width), (one.y, one.height))[axis] for one in (self.shown, self.whole)
        )
        for turn in range(-1, 2) if self.repeats[axis] else (0,):
            first = start + turn * whole[1] - shown[0]
            low, high = max(first, 0), min(first + length, shown[1])
            if low < high:
                yield slice(low, high), slice(low - first, high - first)


def preview_of(whole: Rectangle, period: Period | None) -> Preview:
    """The preview of a map set or texture set, of a field with this period."""
    across, down = period or (None, None)
    repeats = (across == whole.width, down == whole.height)
    # Of what repeats up to two copies, which meet in the middle.
    width, height = (
        min(2 * side, _SIDE) if repeat else side
        for side, repeat in zip((whole.width, whole.height), repeats, strict=True)
    )
    width = min(width, max(_SIDE, _PIXELS // height))
    height = min(height, max(_SIDE, _PIXELS // width))
    x, y = (
        start - shown // 2 if repeat else start + (side - shown) // 2
        for start, side, shown, repeat in zip(
            (whole.x, whole.y), (whole.width, whole.height), (width, height), repeats, strict=True
        )
    )
    return Preview(whole, Rectangle(x, y, width, height), repeats)


def lit_from_top(planes: NDArray[np.float32], normal: NormalStyle) -> NDArray[np.float16]:
    """(H, W, 3) radiance, at most 1, of a block's planes (Source.planes); a white diffuser has 1.

    The light is that of `relight --light top`, at infinite distance.
    """
    from matcap.relight.scene import NAMED_LIGHTS, DirectionalLight, exposing_intensity
    from matcap.relight.texels import light_texels

    place = NAMED_LIGHTS["top"]
    irradiance = exposing_intensity(place) / math.dist(place, (0.0, 0.0, 0.0)) ** 2
    maps = {kind: planes[list(at)] for kind, at in kind_planes(len(planes) - 8).items()}
    if normal == "dx":
        maps["normal"][1] *= -1.0
    del maps["height"]
    radiance = light_texels(**maps, light=DirectionalLight(place, (irradiance,) * 3))
    return np.moveaxis(np.clip(radiance, 0.0, 1.0), 0, -1).astype(np.float16)


class PreviewPicture:
    """Joins the lit parts of a preview."""

    def __init__(self, preview: Preview) -> None:
        self._preview = preview
        self._radiance = np.zeros((preview.shown.height, preview.shown.width, 3), np.float16)

    def add(self, area: Rectangle, part: BlockPart, lit: NDArray[np.float16]) -> None:
        """Copy a part (rows, columns, 3) of a map set of this area to where it is shown."""
        for place, source in self._preview.places(area, part):
            self._radiance[place] = lit[source]

    def encoded(self) -> bytes:
        """The picture as PNG, with the seams marked; dark materials are brightened."""
        bright = float(np.quantile(self._radiance[::8, ::8].astype(np.float32), _BRIGHT_SHARE))
        gain = min(max(_BRIGHT / max(bright, 1e-6), 1.0), _LARGEST_GAIN)
        # Of all half floats up to 1, which are the first in the order of their bits.
        known = np.arange(0x3C01, dtype=np.uint16).view(np.float16).astype(np.float32)
        codes = quantised(srgb_picture(known * gain), bits=8)[self._radiance.view(np.uint16)]
        return png_bytes(_marked(codes, self._preview.repeats))


def _marked(pixels: NDArray[Any], repeats: tuple[bool, bool]) -> NDArray[Any]:
    """The picture in a margin, with wedges that point to the seams in its middle."""
    if not any(repeats):
        return pixels
    sides = ((_MARGIN, _MARGIN), (_MARGIN, _MARGIN), (0, 0))
    sheet = np.pad(pixels, sides, constant_values=_PAPER)
    wedge = np.abs(np.arange(-_MARGIN, _MARGIN) + 0.5) < np.arange(_MARGIN)[:, None]
    for axis in (axis for axis, repeat in enumerate(repeats) if repeat):
        along = np.swapaxes(sheet, 0, axis)  # the seam's line is a column of it
        middle = along.shape[1] // 2
        line = along[:, middle - _MARGIN : middle + _MARGIN]
        line[_MARGIN - 1 :: -1][wedge] = _INK
        line[-_MARGIN:][wedge] = _INK
    return sheet
