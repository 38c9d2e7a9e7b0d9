"""Alignment of photographs from nearly one place: a homography of the sample's plane.

It is fitted to the shifts of tiles at which normalised contrast correlates best. With d the
distance, n the plane's normal, R the turn and t the way of the camera, it is R + t n^T / d, whose
largest and smallest singular values differ by |t| / d.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.photo.inspect import blurred
from matcap.photo.left_out import CLIPPED_SHARE, area_averaged
from matcap.photo.photo import Photo

Picture = NDArray[np.float32]
Matrix = NDArray[np.float64]

# Pixels across of the tiles' grid and of the first, whole shift; pixels of a tile.
COLUMNS, _WHOLE, _TILE = 1024, 256, 128
_ACROSS = 8  # half tiles across, of pictures too small for four of _TILE
_ROUNDS = 3
_FARTHEST = 0.2  # of a side: standard deviation by which nearer shifts are preferred
_INLIER = 1.0  # pixels by which a tile's shift may differ from the homography's
_LEAST_CORRELATION = 0.08  # of a tile's contrast, where a dark picture's is half noise
_LEAST_TILES, _LEAST_AGREEING = 10, 0.4  # number, and share, of tiles that agree
# Pixels across, and least correlation, of the whole picture where too few tiles agree, as on smooth
# materials: of ten materials it is at least 0.44, of unlike pairs of them at most 0.2.
_SMOOTH, _LEAST_WHOLE = 512, 0.3
_SAME_SHAPE = 0.02  # difference of heights over the width
_LEVEL = 128.0  # of normalised contrast, where there is none
FINE = 0.8  # standard deviation of the blur against noise, pixels
_SLOW = 24.0  # standard deviation of the high-pass, pixels
_AROUND = 40.0  # standard deviation of the local contrast, pixels
_FAINT = 0.01  # log radiance added to the local contrast, so that noise is not amplified


def alignment(first: Photo, second: Photo) -> Matrix | None:
    """(3, 3) homography from places in the first photograph to those in the second, (x, y, 1).

    In units of the first's width and of the second's, from the upper left. None if their contrast
    does not agree on one.
    """
    columns = min(COLUMNS, first.pixels.shape[1], second.pixels.shape[1])
    (fixed, seen), (moving, _) = (_contrast(each, columns) for each in (first, second))
    if abs(len(fixed) - len(moving)) > _SAME_SHAPE * columns:
        return None
    size = _WHOLE, 2 * (round(_WHOLE * len(fixed) / columns) // 2)
    small = (area_averaged(each, size)[None] for each in (fixed, moving))
    shift = _shifts(*small)[0][0] * (columns / _WHOLE)
    warp = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]], [0.0, 0.0, 1.0]])
    places = _tiles(seen, min(_TILE, 2 * (columns // _ACROSS)))
    if len(places) < _LEAST_TILES:
        return _turned(first, second)
    for start in (warp, np.eye(3)):
        homography, agreeing = _refined(fixed, moving, places, start)
        if agreeing >= max(_LEAST_TILES, _LEAST_AGREEING * len(places)):
            break
    else:
        return _turned(first, second)
    units = pixel_units(columns)
    return np.asarray(units @ homography @ np.linalg.inv(units))


def pixel_units(columns: int) -> Matrix:
    """(3, 3) from places of pixels, 0 in the middle of the first, to units of a width."""
    return np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, columns]]) / columns


def _turned(first: Photo, second: Photo) -> Matrix | None:
    """alignment() of a camera that was only turned, by the whole picture's best shift.

    For smooth materials, of which the darker picture shows little but noise in most tiles.
    """
    columns = min(_SMOOTH, first.pixels.shape[1], second.pixels.shape[1])
    fixed, moving = (_contrast(each, columns)[0] for each in (first, second))
    rows = min(len(fixed), len(moving))
    shifts, correlation = _shifts(fixed[None, :rows], moving[None, :rows])
    if correlation[0] < _LEAST_WHOLE:
        return None
    across, down = shifts[0] / columns
    lens = _lens(first.fov, rows / columns)
    turn, _ = cv2.Rodrigues(np.array([-down, across, 0.0]) / lens[0, 0])
    return np.asarray(lens @ turn @ np.linalg.inv(lens))


def _refined(
    fixed: Picture, moving: Picture, places: NDArray[np.int64], warp: Matrix
) -> tuple[Matrix, int]:
    """A homography (3, 3) of pixels fitted to shifts of tiles, and how many tiles agree on it."""
    size, count = fixed.shape[::-1], 0
    tile = min(_TILE, 2 * (size[0] // _ACROSS))
    middles = (places + 0.5 * (tile - 1)).astype(np.float64)
    for _ in range(_ROUNDS):
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        near = np.asarray(cv2.warpPerspective(moving, warp, size, flags=flags), np.float32)
        cut = [np.stack([each[y : y + tile, x : x + tile] for x, y in places])
               for each in (fixed, near)]  # fmt: skip
        shifts, strength = _shifts(*cut)
        usable = strength > _LEAST_CORRELATION
        if usable.sum() < _LEAST_TILES:
            return warp, 0
        before, after = middles[usable], (middles + shifts)[usable]
        change, kept = cv2.findHomography(before, after, cv2.RANSAC, _INLIER)
        if change is None:
            return warp, 0
        warp, count = warp @ change, int(kept.sum())
        if count < _LEAST_TILES:  # already of the shift alone, if they show the same
            break
    return warp, count


def _shifts(fixed: Picture, moving: Picture) -> tuple[Matrix, NDArray[np.float64]]:
    """(n, 2) shifts (x, y) in pixels from pictures (n, h, w) to others, and their correlation.

    The maximum of the circular cross-correlation under a Hann window, to a fraction of a pixel by
    a parabola; smaller shifts are preferred, as patterns repeat.
    """
    count, height, width = fixed.shape
    window = np.float32(np.hanning(height)[:, None] * np.hanning(width))
    first, second = (np.fft.rfft2(each * window) for each in (fixed, moving))
    correlation = np.fft.irfft2(np.conj(first) * second, (height, width))
    power = np.sqrt(np.prod([np.square(each * window).sum((1, 2)) for each in (fixed, moving)], 0))
    y, x = (np.fft.fftfreq(side) for side in (height, width))
    nearer = np.exp(-0.5 * (np.square(y)[:, None] + np.square(x)) / _FARTHEST**2)
    peak = (correlation * nearer).reshape(count, -1).argmax(1)
    row, column, every = peak // width, peak % width, np.arange(count)
    here = correlation[every, row, column]

    def vertex(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
        bend = np.minimum(low + high - 2.0 * here, -1e-12)
        return np.asarray(np.clip(0.5 * (low - high) / bend, -0.5, 0.5))

    up, down = correlation[every, row - 1, column], correlation[every, (row + 1) % height, column]
    left, right = correlation[every, row, column - 1], correlation[every, row, (column + 1) % width]
    shifts = np.stack([x[column] * width + vertex(left, right), y[row] * height + vertex(up, down)])
    return shifts.T, here / np.maximum(power, 1e-12)


def _tiles(seen: NDArray[np.bool_], tile: int) -> NDArray[np.int64]:
    """(n, 2) upper left corners (x, y) of tiles most of which is usable."""
    height, width = seen.shape
    step = tile // 2
    corners = [
        (x, y)
        for y in range(0, height - tile + 1, step)
        for x in range(0, width - tile + 1, step)
        if seen[y : y + tile, x : x + tile].mean() > 0.5
    ]
    return np.array(corners, np.int64).reshape(-1, 2)


def way_of_camera(homography: Matrix, first: Photo, second: Photo) -> float:
    """Way of the camera between two photographs, over the distance of the plane."""
    lens, second_lens = (
        _lens(photo.fov, photo.pixels.shape[0] / photo.pixels.shape[1]) for photo in (first, second)
    )
    values = np.linalg.svd(np.linalg.inv(second_lens) @ homography @ lens, compute_uv=False)
    return float((values[0] - values[2]) / values[1])


def way_of_highlight(homography: Matrix, first: Photo, second: Photo) -> tuple[float, float]:
    """Way (x, y) of the flash's mirror point from the first photograph to the second, on the plane,
    in widths of the first.

    A flash goes with its camera, and so does its mirror point. Of R + t n^T / d, vectors across n
    are turned only; n is taken for the first camera's axis, which ten degrees change by a sixth.
    """
    lenses = (
        _lens(photo.fov, photo.pixels.shape[0] / photo.pixels.shape[1]) for photo in (first, second)
    )
    lens, second_lens = lenses
    motion = np.linalg.inv(second_lens) @ homography @ lens
    motion = motion / (np.linalg.svd(motion, compute_uv=False)[1] * np.sign(np.linalg.det(motion)))
    left, _, right = np.linalg.svd(motion[:, :2], full_matrices=False)
    across = left @ right
    turn = np.column_stack([across, np.cross(across[:, 0], across[:, 1])])
    x, y, _ = -turn.T @ (motion[:, 2] - turn[:, 2])
    return float(lens[0, 0] * x), float(lens[0, 0] * y)


def _lens(fov: float, side: float) -> Matrix:
    """(3, 3) calibration of a camera in units of its picture's width, `side` being its height."""
    focal = focal_length(fov)
    return np.array([[focal, 0.0, 0.5], [0.0, focal, side / 2.0], [0.0, 0.0, 1.0]])


def focal_length(fov: float) -> float:
    """Focal length in widths of the picture."""
    return 0.5 / math.tan(math.radians(fov) / 2.0)


def _contrast(photo: Photo, columns: int) -> tuple[Picture, NDArray[np.bool_]]:
    """(h, w) normalised contrast at so many pixels across, and where it is usable."""
    rows = round(columns * photo.pixels.shape[0] / photo.pixels.shape[1])
    size = (columns, rows)
    grey = area_averaged(photo.pixels, size).mean(axis=2)
    full = area_averaged(photo.clipped.astype(np.float32), size)
    seen = cv2.erode((full < CLIPPED_SHARE).astype(np.uint8), np.ones((5, 5), np.uint8))
    usable = (seen > 0) & (grey >= 1e-4)
    contrast = np.where(usable, normalise_contrast(grey).astype(np.float32) - _LEVEL, 0.0)
    return np.asarray(contrast, np.float32), usable


def normalise_contrast(grey: NDArray[np.float32]) -> NDArray[np.uint8]:
    """8-bit high-passed log radiance over its local mean amplitude."""
    log = np.log(np.maximum(grey, 1e-5))
    fine = blurred(log, FINE) - blurred(log, _SLOW)
    size = np.sqrt(blurred(fine * fine, _AROUND)) + _FAINT
    return np.asarray((_LEVEL + 48.0 * fine / size).clip(0, 255).round().astype(np.uint8))
