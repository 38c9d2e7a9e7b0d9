"""Parts of a photograph that are left out: crop, mask, transparency, border; area downsampling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError, UsageError
from matcap.files.pixels import read_mask
from matcap.files.settings import Rectangle
from matcap.photo.photo import SHORTEST_SIDE, Photo, ToneCurve, quarter_turn

# Area downsampling of linear pixels, strip by strip, without a full-size float copy.

Rows = tuple[NDArray[np.float32], NDArray[np.bool_]]
ReadRows = Callable[[int, int], Rows]

CLIPPED_SHARE = 0.25  # clipped share of its area from which on a downsampled pixel is clipped
_STRIP_PIXELS = 1 << 20  # pixels of a strip
_PART = 1e-3  # share of a pixel that is not the material, from which on it is left out


def shrink(read: ReadRows, width: int, height: int, long_side: int | None) -> Rows:
    """Downsample a picture by area averages; never upsample.

    Args:
        read: (first row, row after the last) -> linear pixels (n, W, 3) and clip mask (n, W).
        width, height: of the whole picture.
        long_side: of the result, pixels; None is the picture's own.

    Returns:
        pixels (h, w, 3) float32 and mask (h, w).
    """
    new_width, new_height = shrunk_size(width, height, long_side)
    step = max(1, _STRIP_PIXELS // width)
    strips = [(top, min(top + step, height)) for top in range(0, height, step)]
    if (new_width, new_height) == (width, height):
        pixels = np.empty((height, width, 3), np.float32)
        clipped = np.empty((height, width), np.bool_)
        for top, bottom in strips:
            pixels[top:bottom], clipped[top:bottom] = read(top, bottom)
        return pixels, clipped
    # Along rows first, strip by strip, so that the intermediate result is small.
    narrow = np.empty((height, new_width, 3), np.float32)
    narrow_mask = np.empty((height, new_width), np.float32)
    for top, bottom in strips:
        strip, mask = read(top, bottom)
        narrow[top:bottom] = area_averaged(strip, (new_width, bottom - top))
        narrow_mask[top:bottom] = area_averaged(mask.astype(np.float32), (new_width, bottom - top))
    share = area_averaged(narrow_mask, (new_width, new_height))
    # With a tolerance for rounding, so that exactly CLIPPED_SHARE counts.
    return area_averaged(narrow, (new_width, new_height)), share >= CLIPPED_SHARE - 1e-5


def shrunk_size(width: int, height: int, long_side: int | None) -> tuple[int, int]:
    """(width, height) scaled to a long side of at most long_side."""
    longest = max(width, height)
    if long_side is None or long_side >= longest:
        return width, height
    return max(1, round(width * long_side / longest)), max(1, round(height * long_side / longest))


def area_averaged(picture: NDArray[Any], size: tuple[int, ...]) -> NDArray[np.float32]:
    """A picture (H, W) or (H, W, C) shrunk to (width, height) by means over areas."""
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)


def dilated(where: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """(H, W) whether a place is up to `reach` pixels away along rows and columns."""
    square = np.ones((2 * reach + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(where.astype(np.uint8), square) > 0)


def shrunk(photo: Photo, long_side: int, tone: ToneCurve) -> Photo:
    """A photograph of which no noise is known, downsampled, its tone curve undone before."""
    height, width = photo.clipped.shape
    known = tone if photo.tone_mapped else ToneCurve()

    def read(top: int, bottom: int) -> Rows:
        return known.linear(photo.pixels[top:bottom]), photo.clipped[top:bottom]

    pixels, clipped = shrink(read, width, height, long_side)
    left_out = photo.left_out
    if left_out is not None:
        share = area_averaged(left_out.astype(np.float32), pixels.shape[1::-1])
        left_out = np.asarray(share > _PART)
    return replace(
        photo,
        pixels=pixels,
        clipped=clipped,
        left_out=left_out,
        headroom=float(known.linear(np.array(photo.headroom))),
        tone=tone if photo.tone_mapped else photo.tone,
    )


def cell_means(
    picture: NDArray[np.float32], columns: int, least_rows: int = 1
) -> NDArray[np.float32]:
    """Means of a picture (H, W) or (H, W, C) over about square cells, so many across."""
    height, width = picture.shape[:2]
    return area_averaged(picture, (columns, max(least_rows, round(columns * height / width))))


# Detects a border that is not the material, such as a table's edge or another sheet.
#
# The photograph is averaged to cells; each line of cells along a side is reduced to the medians of
# two log hues and log brightness. A border begins at a step between lines that is larger than those
# in the middle, if all lines beyond it differ from those before it. The gradual falloff of a flash
# has no such step.

Values = NDArray[np.float64]

# Thresholds of a border.
_CELLS = 64  # along the long side; a step is one or two cells wide
_LEAST_STEP = (0.15, 0.15, 0.35)  # least step of the two log hues and log brightness
_UNLIKE = 4.0  # least ratio of a step to the 0.9 quantile of those in the middle
_KEPT = 0.6  # share of that limit by which all lines beyond must differ
_BEFORE = 4  # number of lines that they are compared with
_MOST = 0.3  # largest share of a side to crop at each end
_DARK = 0.15  # added inside logarithms, as a share of the median


def border_crop(photo: Photo) -> Rectangle | None:
    """The crop that removes borders, in pixels of the file's upright picture; None without any."""
    cells = _cells(photo.pixels)
    rows, columns = cells.shape[1:]
    ends = [_cut(cells.transpose(0, 2, 1)), _cut(cells.transpose(0, 2, 1)[:, ::-1])]
    ends += [_cut(cells), _cut(cells[:, ::-1])]
    if not any(ends):
        return None
    left, right, top, bottom = ends
    # Shares of the landscape picture, rotated back for portraits.
    box = (left / columns, 1.0 - right / columns, top / rows, 1.0 - bottom / rows)
    if photo.turned:
        box = (1.0 - box[3], 1.0 - box[2], box[0], box[1])
    width, height = photo.original_size
    x, y = round(box[0] * width), round(box[2] * height)
    return Rectangle(x, y, round(box[1] * width) - x, round(box[3] * height) - y)


def _cells(pixels: NDArray[np.float32]) -> Values:
    """(3, rows, columns) cells: log(R / G), log(B / G), mean log radiance."""
    height, width = pixels.shape[:2]
    columns = min(_CELLS, width)
    rows = max(8, round(columns * height / width))
    small = area_averaged(pixels, (columns, rows)).astype(np.float64)
    log = np.log(small + _DARK * float(np.median(small)) + 1e-9)
    return np.stack([log[..., 0] - log[..., 1], log[..., 2] - log[..., 1], log.mean(axis=-1)])


def _cut(cells: Values) -> int:
    """Number of first lines of cells (3, lines, along) that are a border."""
    _, count, along = cells.shape
    lines = np.median(cells[:, :, along // 8 : along - along // 8], axis=2)
    steps = np.abs(lines[:, 2:] - lines[:, :-2])  # across line k + 1
    usual = np.quantile(steps[:, count // 4 : count - count // 4], 0.9, axis=1)
    limit = np.maximum(_LEAST_STEP, _UNLIKE * usual)[:, None]
    over = (steps[:, : int(_MOST * count)] / limit).max(axis=0)
    for at in np.argsort(-over):
        if over[at] <= 1.0:
            break
        plane = int(np.argmax(steps[:, at] / limit[:, 0]))
        beyond = lines[plane, : at + 1] - np.median(lines[plane, at + 2 : at + 2 + _BEFORE])
        sign = np.sign(beyond[at])
        if (sign * beyond > _KEPT * limit[plane, 0]).all():
            return int(at) + 2
    return 0


# Leaves out parts of a photograph: outside a crop, black in a mask, or transparent.
#
# The photograph keeps its size, so that its centre stays on the optical axis. Pixels that are left
# out are not used in measurements. For filters and networks they are replaced by mirrored pixels.

_LEAST = 0.04  # least share of a photograph that must remain
_GREY = 0.5  # mask value up to which pixels are left out
_FOLDED = 0.1  # depth of the mirrored pixels, share of the shorter side

Kept = NDArray[np.bool_]


def leave_out(photo: Photo, crop: Rectangle | None, mask: Path | None) -> Photo:
    """Restrict a photograph to the part that shows the material.

    Args:
        crop: rectangle of the material, in pixels of the file's upright picture.
        mask: image of that size: white is the material, black is left out.

    Raises:
        UsageError: a crop outside the photograph, or too small.
        MatcapError: a mask that cannot be read, of another size, or that leaves too little.
    """
    if crop is None and mask is None:
        return photo
    width, height = photo.original_size
    kept = np.ones((height, width), np.bool_)
    if crop is not None:
        kept &= _cropped(crop, width, height)
    if mask is not None:
        kept &= _masked(mask, width, height)
    lying = np.ascontiguousarray(quarter_turn(kept) if photo.turned else kept)
    rows, columns = photo.pixels.shape[:2]
    share = area_averaged(lying.astype(np.float32), (columns, rows))
    return _only(photo, np.asarray(share, np.float32), "the mask leaves", str(mask or photo.name))


def leave_transparent_out(photo: Photo, opacity: NDArray[np.float32], where: str) -> Photo:
    """Restrict a photograph to its opaque pixels.

    Args:
        opacity: (H, W) of its pixels, in [0, 1].

    Raises:
        MatcapError: too little is opaque.
    """
    return _only(photo, opacity, "its transparency leaves", where)


def _only(photo: Photo, share: NDArray[np.float32], what: str, where: str) -> Photo:
    """Leave out pixels whose share (H, W) of the material is below 1, besides those left out."""
    left_out = share < 1.0 - _PART
    if not left_out.any():
        return photo
    if photo.left_out is not None:
        left_out = left_out | photo.left_out
    if 1.0 - left_out.mean() < _LEAST:
        raise MatcapError.at(
            where,
            f"{what} {100 * (1.0 - left_out.mean()):.2g} % of the photograph",
            "paint the material white (or leave it opaque), and only the rest black",
        )
    places = mirrored(left_out)
    every = ((name, getattr(photo, name)) for name in ("pixels", "clipped", "noise"))
    changed = {name: planes.copy() for name, planes in every if planes is not None}
    for planes in changed.values():
        planes[left_out] = planes[places]
    return replace(
        photo,
        **changed,
        stored_clipped_share=None,
        left_out=left_out,
        notes=(*photo.notes, f"{100 * left_out.mean():.0f} % of the photograph is left out."),
    )


def _cropped(crop: Rectangle, width: int, height: int) -> Kept:
    """(H, W) mask of a crop."""
    right, bottom = crop.x + crop.width, crop.y + crop.height
    if crop.x < 0 or crop.y < 0 or right > width or bottom > height:
        raise UsageError.at(
            "--crop",
            f"{crop} reaches beyond the photograph of {width} x {height} pixels",
            "give x,y,w,h within it, in pixels of the upright picture from its top left",
        )
    if min(crop.width, crop.height) < SHORTEST_SIDE or crop.width * crop.height < _LEAST * (
        width * height
    ):
        raise UsageError.at(
            "--crop",
            f"{crop.width} x {crop.height} pixels are too few to hold a texture",
            f"keep at least {SHORTEST_SIDE} a side and {100 * _LEAST:.0f} % of the picture",
        )
    kept = np.zeros((height, width), np.bool_)
    kept[crop.y : bottom, crop.x : right] = True
    return kept


def _masked(mask: Path, width: int, height: int) -> Kept:
    """(H, W) pixels that are white in a mask's file."""
    if not mask.is_file():
        raise MatcapError.at(mask, "there is no such file", "give a PNG file")
    grey = read_mask(mask)
    if grey.shape != (height, width):
        raise MatcapError.at(
            mask,
            f"the mask is {grey.shape[1]} x {grey.shape[0]} pixels, the photograph "
            f"{width} x {height}",
            "paint it over the upright photograph, at its full size",
        )
    return np.asarray(grey > _GREY)


def largest_rectangle(kept: Kept) -> tuple[slice, slice]:
    """Rows and columns of the largest rectangle of kept pixels, by squares of a 128th of a side.

    For each row, the largest rectangle under the histogram of kept squares above it.
    """
    side = max(1, max(kept.shape) // 128)
    rows, columns = (n // side for n in kept.shape)
    whole = kept[: rows * side, : columns * side].reshape(rows, side, columns, side)
    heights = np.zeros(columns + 1, np.int64)
    area, best = 0, (0, 0, 0, 0)
    squares: Kept = np.asarray(whole.all(axis=(1, 3)), np.bool_)
    for row, full in enumerate(squares):
        heights[:-1] = np.where(full, heights[:-1] + 1, 0)
        open_: list[int] = []
        for column, height in enumerate(heights):
            while open_ and heights[open_[-1]] >= height:
                high = int(heights[open_.pop()])
                left = open_[-1] + 1 if open_ else 0
                if high * (column - left) > area:
                    area, best = high * (column - left), (row + 1 - high, row + 1, left, column)
            open_.append(column)
    top, bottom, left, right = (edge * side for edge in best)
    # The last rows and columns are no whole square.
    bottom = kept.shape[0] if bottom == rows * side and kept[bottom:, left:right].all() else bottom
    right = kept.shape[1] if right == columns * side and kept[top:bottom, right:].all() else right
    return slice(top, bottom), slice(left, right)


def mirrored(left_out: Kept) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(n,) rows and columns of mirrored pixels, which those left out (H, W) are read from.

    Mirrored at the nearest pixel that is kept; the distance beyond it is folded at _FOLDED of the
    picture's shorter side.
    """
    rows, columns = left_out.shape
    _, labels = cv2.distanceTransformWithLabels(
        left_out.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    y, x = np.nonzero(left_out)
    nearest = np.zeros(int(labels.max()) + 1, np.int64)
    nearest[labels[~left_out]] = np.flatnonzero(~left_out)
    near_y, near_x = np.divmod(nearest[labels[left_out]], columns)
    distance = np.hypot(near_y - y, near_x - x)
    reach = max(1.0, _FOLDED * min(rows, columns))
    share = (reach - np.abs(distance % (2.0 * reach) - reach)) / np.maximum(distance, 1e-9)
    to_y = np.rint(near_y + share * (near_y - y)).astype(np.intp).clip(0, rows - 1)
    to_x = np.rint(near_x + share * (near_x - x)).astype(np.intp).clip(0, columns - 1)
    # Where the mirrored pixel is left out, too, the nearest kept pixel is used.
    lost = left_out[to_y, to_x]
    return np.where(lost, near_y, to_y), np.where(lost, near_x, to_x)
