"""Leaves out parts of a photograph: outside a crop, black in a mask, or transparent.

The photograph keeps its size, so that its centre stays on the optical axis. Pixels that are left
out are not used in measurements. For filters and networks they are replaced by mirrored pixels.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError, UsageError
from matcap.files.mask import read_mask
from matcap.files.values import Rectangle
from matcap.photo.orient import quarter_turn
from matcap.photo.photo import Photo
from matcap.photo.refusals import SHORTEST_SIDE
from matcap.photo.shrink import area_averaged

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
    left_out = share < 1.0 - 1e-3
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
    return replace(
        photo,
        pixels=np.ascontiguousarray(photo.pixels[places]),
        clipped=np.ascontiguousarray(photo.clipped[places]),
        noise=None if photo.noise is None else np.ascontiguousarray(photo.noise[places]),
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


def mirrored(left_out: Kept) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(H, W) rows and columns to read each pixel from: itself, or a mirrored one if left out.

    Mirrored at the nearest pixel that is kept; the distance beyond it is folded at _FOLDED of the
    picture's shorter side.
    """
    rows, columns = left_out.shape
    _, labels = cv2.distanceTransformWithLabels(
        left_out.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    y, x = np.indices(left_out.shape)
    kept = ~left_out
    nearest = np.zeros(int(labels.max()) + 1, np.int64)
    nearest[labels[kept]] = np.flatnonzero(kept)
    at = nearest[labels]
    near_y, near_x = at // columns, at % columns
    distance = np.hypot(near_y - y, near_x - x)
    reach = max(1.0, _FOLDED * min(rows, columns))
    folded = reach - np.abs(distance % (2.0 * reach) - reach)
    share = np.where(left_out, folded / np.maximum(distance, 1e-9), 0.0)
    to_y = np.rint(near_y + share * (near_y - y)).astype(np.intp).clip(0, rows - 1)
    to_x = np.rint(near_x + share * (near_x - x)).astype(np.intp).clip(0, columns - 1)
    # Where the mirrored pixel is left out, too, the nearest kept pixel is used.
    lost = left_out[to_y, to_x]
    return np.where(lost, near_y, to_y), np.where(lost, near_x, to_x)
