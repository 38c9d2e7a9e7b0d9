"""Reads RAW files by rawpy (LibRaw) to scene-linear Rec.709, with their sensor noise."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.containers import decoding, unreadable
from matcap.photo.dng import Corrections
from matcap.photo.left_out import Rows, shrink
from matcap.photo.photo import Decoded, Photo, check_size
from matcap.photo.raw_samples import GainMap, Shading, centre_colours, plain_dng

# Sensor noise: estimated from the mosaic, and sampled.
#
# Shot and read noise give a photosite the variance shot * signal + read [foi2008]. Noise is
# independent between photosites, while a lens blurs the image. The response to a checkerboard of
# single photosites is therefore mostly noise, and in the smoothest blocks entirely.
#
# Captures need it because noise resembles texture: the same noise is added to renderings before
# they are compared with the photograph (space/tuning/finetune.py).

# Mixed second difference [immerkaer1996]: 0 for images that are linear along x or y, of unit gain
# for noise.
_CHECKER = np.outer((1.0, -2.0, 1.0), (1.0, -2.0, 1.0)).astype(np.float32) / 6.0
_SMOOTH = 1.5  # standard deviation of the signal's blur, photosites of one colour
_BLOCK = 16  # photosites a side of a block, in which variance is measured
_TILE = 256  # photosites a side of a tile
_TILES = 48  # most tiles that are used
_BINS, _BLOCKS_IN_BIN = 16, 20  # most bins by signal, and least blocks in a bin
_PLAIN = 0.1  # quantile of the variance over a bin's blocks, which are taken as textureless
# That quantile in a flat field, as a share of the noise's variance.
_FLAT_FIELD = 0.69
_AGREES = 1.05  # ratio to the line above which a bin's variance includes texture
_LEAST_BINS = 4  # for the line's fit
_ROUNDING = 1 / 12  # variance of rounding to integers
_DARKEST = 1 / 500  # lower limit of the signal, share of the white level
_STRIP_PHOTOSITES = 1 << 20  # processed at once


@dataclass(frozen=True)
class SensorNoise:
    """Noise model: variance = shot * signal + read, of the file's values above black."""

    shot: float
    """Variance over signal, the value of one photon."""
    read: float
    """Variance at signal 0."""

    def added(
        self, mosaic: NDArray[np.uint16], black: NDArray[np.float64], seed: int
    ) -> NDArray[np.uint16]:
        """The mosaic (H, W) with a sample of the noise added; `black` as in find_noise."""
        generator = np.random.default_rng(seed)
        result = np.empty_like(mosaic)
        step = max(2, _STRIP_PHOTOSITES // mosaic.shape[1] // 2 * 2)
        for top in range(0, len(mosaic), step):
            stored = mosaic[top : top + step].astype(np.float32)
            signal = np.maximum(stored - _tiled(black, stored.shape), 0.0)
            stored += np.sqrt(self.shot * signal + self.read) * generator.standard_normal(
                stored.shape, np.float32
            )
            result[top : top + step] = np.rint(stored).clip(0, np.iinfo(np.uint16).max)
        return result


def find_noise(
    mosaic: NDArray[np.uint16], black: NDArray[np.float64], white: float
) -> SensorNoise | None:
    """Estimate the noise of a Bayer mosaic; an upper bound if all of it has the finest texture.

    Args:
        mosaic: (H, W) stored values.
        black: (2, 2) black level by position in the pattern.
        white: saturation level.

    Returns:
        The noise model; None if too few blocks are well exposed.
    """
    pieces = [_measured(tile, black, white) for tile in _tiles(mosaic)]
    variance, shot, read = np.concatenate(pieces, axis=1) if pieces else np.empty((3, 0))
    bins = min(_BINS, variance.size // _BLOCKS_IN_BIN)
    if bins == 0:
        return None
    # A block's effective signal, dominated by its darker photosites.
    signal = shot / read
    order = np.argsort(signal)
    edges = np.linspace(0, order.size, bins + 1).astype(int)
    points = []
    for first, last in pairwise(edges):
        at = order[first:last]
        plainest = np.quantile(variance[at] / shot[at], _PLAIN) / _FLAT_FIELD
        points.append((signal[at].mean(), max(plainest * signal[at].mean(), _ROUNDING)))
    return _lower_line(np.array(points))


def _tiles(mosaic: NDArray[np.uint16]) -> list[NDArray[np.uint16]]:
    """At most _TILES tiles, evenly spread, aligned with the pattern."""
    height, width = (side // 2 * 2 for side in mosaic.shape)
    rows, columns = (max(1, side // _TILE) for side in (height, width))
    places = list(product(range(rows), range(columns)))
    every = -(-len(places) // _TILES)
    tall, wide = min(_TILE, height), min(_TILE, width)
    return [
        mosaic[row * _TILE : row * _TILE + tall, column * _TILE : column * _TILE + wide]
        for row, column in places[::every]
    ]


def _measured(
    tile: NDArray[np.uint16], black: NDArray[np.float64], white: float
) -> NDArray[np.float64]:
    """(3, blocks) relative variance, and its value for shot noise of 1 and for read noise of 1."""
    numbers = tile.astype(np.float32)
    signal = numbers - _tiled(black, tile.shape)
    smooth = np.empty_like(signal)
    for row, column in product((0, 1), repeat=2):
        sites = np.s_[row::2, column::2]
        smooth[sites] = cv2.GaussianBlur(signal[sites], (0, 0), _SMOOTH)
    smooth = np.maximum(smooth, np.float32(_DARKEST * (white - black.max())))
    checker = cv2.filter2D(signal / smooth, -1, _CHECKER)
    shot, read = (cv2.filter2D(smooth**-power, -1, _CHECKER**2) for power in (1, 2))
    saturated = cv2.dilate((numbers >= 0.97 * white).astype(np.float32), np.ones((9, 9)))
    usable = _blocks(saturated) == 0.0
    return np.stack([_blocks(checker**2)[usable], _blocks(shot)[usable], _blocks(read)[usable]])


def _blocks(picture: NDArray[Any]) -> NDArray[np.float64]:
    """(blocks,) means of whole blocks."""
    height, width = (side // _BLOCK for side in picture.shape)
    whole = picture[: height * _BLOCK, : width * _BLOCK]
    shaped = whole.reshape(height, _BLOCK, width, _BLOCK)
    return np.asarray(shaped.mean(axis=(1, 3), dtype=np.float64)).ravel()


def _lower_line(points: NDArray[np.float64]) -> SensorNoise:
    """Fit the line to (signal, variance) points, dropping those above it, which include texture."""
    signal, variance = points.T
    kept = np.ones(len(points), bool)
    while True:
        line = _line(signal[kept], variance[kept])
        above = variance / (line.shot * signal + line.read)
        allowed = max(_AGREES, np.sort(above)[min(_LEAST_BINS, len(above)) - 1])
        remaining = kept & (above <= allowed)
        if remaining.sum() == kept.sum() or not remaining.any():
            return line
        kept = remaining


def _line(signal: NDArray[np.float64], variance: NDArray[np.float64]) -> SensorNoise:
    """Least-squares line in relative errors, with non-negative shot and read noise."""
    terms = np.stack([signal, np.ones_like(signal)], axis=1) / variance[:, None]
    ones = np.ones_like(signal)
    if len(signal) > 1:
        shot, read = np.linalg.lstsq(terms, ones)[0]
        if shot >= 0.0 and read >= 0.0:
            return SensorNoise(float(shot), float(read))
    alone = terms.sum(axis=0) / np.square(terms).sum(axis=0)
    worse = np.square(terms * alone - ones[:, None]).sum(axis=0)
    if worse[0] <= worse[1]:
        return SensorNoise(float(alone[0]), 0.0)
    return SensorNoise(0.0, float(alone[1]))


def _tiled(black: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """(H, W) black levels, by repeating the pattern."""
    rows, columns = np.arange(shape[0])[:, None] % 2, np.arange(shape[1])[None, :] % 2
    return black.astype(np.float32)[rows, columns]


# Reads RAW files by rawpy (LibRaw): scene-linear, camera white balance, Rec.709.
#
# A DNG's white balance and colour matrix are computed from its tags (dng.py), and LibRaw
# returns camera colours, so that colours outside Rec.709 are not clipped. For other files they are
# LibRaw's; without a stated white balance LibRaw's daylight multipliers are used.
#
# LibRaw ignores a DNG's lens-shading maps; they are applied to the mosaic before it is developed.
# Clipping is detected in the mosaic, as channels clip at different values after white balance.
# DNGs that it cannot read or misreads are rewritten first (raw_samples.py).
#
# Noise is sampled on the mosaic and developed in the same way, so that the effects of demosaicing,
# colour conversion and downsampling on it need no model.

# Share of the white level from which on photosites count as clipped; they saturate a little below.
LibRaw = Any  # an open rawpy.RawPy, which has no types
Balance = tuple[float, float, float]
CLIP_SHARE = 0.99
_FULL = 65535  # code values
_AVERAGED = 6.0  # downsampling factor from which on noise is neglected
# Downsampling factor from which on a mosaic is averaged by 2 x 2 instead of demosaiced. From 2 on,
# exemplars of ten materials had an NSD of 1.73, not 1.63, as fine texture became false colour.
_BINNED = 4.0
_OWN_COLOURS = "LibRaw knows no colour matrix of this camera: its colours are taken for Rec.709."
_SEED = 0  # of the noise sample
# EXIF's orientation by LibRaw's flip (bits: mirror columns, mirror rows, transpose).
_ORIENTATION = {0: 1, 1: 2, 2: 4, 3: 3, 4: 5, 5: 8, 6: 6, 7: 7}


def read_raw(
    path: Path, long_side: int | None, corrections: Corrections, *, noise: bool = True
) -> Decoded:
    """Develop a RAW file.

    Args:
        long_side: of the result, pixels. At a quarter of the sensor's or less, the mosaic is
            averaged by 2 x 2 instead of demosaiced.
        corrections: of a DNG; Corrections() for other files.
        noise: compute Photo.noise, for which the file is developed twice.

    Raises:
        MatcapError: truncated, damaged, not supported or too small.
    """
    rewritten = None
    if corrections.samples != "plain":
        misread = corrections.samples == "misread"
        rewritten = plain_dng(path, corrections.on_mosaic.value_maps if misread else None)
    with decoding(path, "RAW"), _opened(path, rewritten) as raw:
        part = _shown(raw, corrections)
        height, width = part[0].stop - part[0].start, part[1].stop - part[1].start
        check_size(path, width, height)
        _check_levels(path, raw)
        bayer = raw.raw_pattern is not None and raw.raw_pattern.shape == (2, 2)
        reduced = max(width, height) / (long_side or max(width, height))
        half = bayer and reduced >= _BINNED
        # Before developing, which resets the flip.
        orientation = _ORIENTATION[raw.sizes.flip]
        balance, unstated = _balance(raw, corrections)
        saturated, share = _saturated(raw, balance, bayer, half)
        mosaic = _noisy(raw) if bayer and noise and reduced < _AVERAGED else None
        developed, headroom = _develop(raw, corrections, balance, half)
    again = None
    if mosaic is not None:
        # Opened again, as developing changes the mosaic that LibRaw returns.
        with decoding(path, "RAW"), _opened(path, rewritten) as raw:
            raw.raw_image_visible[...] = mosaic
            again, _ = _develop(raw, corrections, balance, half)
    if developed.shape != (*saturated.shape, 3):
        raise MatcapError.at(
            path,
            "the camera's sensor is not laid out in rows and columns of square pixels",
            "give a developed picture, a TIFF say",
        )

    step = 2 if half else 1
    within = tuple(slice(side.start // step, side.stop // step) for side in part)
    developed, saturated = developed[within], saturated[within]
    again = None if again is None else again[within]
    scale = np.float32(headroom / _FULL)
    own = corrections.color
    matrix = None if own is None else own.matrix.T.astype(np.float32) * scale

    def rows_of(picture: NDArray[np.uint16], top: int, bottom: int) -> Rows:
        rows = picture[top:bottom]
        clipped = saturated[top:bottom] | (rows == _FULL).any(axis=-1)
        if matrix is None:
            return rows * scale, clipped
        return np.maximum(rows.astype(np.float32) @ matrix, 0.0), clipped

    size = developed.shape[1], developed.shape[0]
    pixels, clipped = shrink(partial(rows_of, developed), *size, long_side)
    noisy = None if again is None else shrink(partial(rows_of, again), *size, long_side)[0]
    photo = Photo(
        pixels,
        clipped,
        radiometric=True,
        original_size=(width, height),
        gain_map_applied=corrections.has_maps,
        notes=corrections.notes + ((unstated,) if unstated else ()),
        stored_clipped_share=share,
        noise=None if noisy is None else noisy - pixels,
        balance=balance,
    )
    whole = corrections.crop.sizes[1] if corrections.crop else None
    return Decoded(photo, orientation, whole=whole)


def _shown(raw: LibRaw, corrections: Corrections) -> tuple[slice, slice]:
    """Rows and columns of LibRaw's visible area that are the picture."""
    sizes = raw.sizes
    rows, columns = slice(0, sizes.height), slice(0, sizes.width)
    if corrections.crop is None:
        return rows, columns
    visible = (sizes.top_margin, sizes.left_margin)
    start = corrections.active_area[:2] if corrections.active_area else visible
    top, left, bottom, right = corrections.crop.shown
    down, across = start[0] - visible[0], start[1] - visible[1]
    rows = slice(max(top + down, 0), min(bottom + down, sizes.height))
    columns = slice(max(left + across, 0), min(right + across, sizes.width))
    return rows, columns


def _noisy(raw: LibRaw) -> NDArray[np.uint16] | None:
    """The mosaic with an independent sample of its noise added; None if it is unknown."""
    mosaic = raw.raw_image_visible
    black = np.array(raw.black_level_per_channel, np.float64)[raw.raw_colors_visible[:2, :2]]
    noise = find_noise(mosaic, black, float(raw.white_level))
    return None if noise is None else noise.added(mosaic, black, _SEED)


def _develop(
    raw: LibRaw, corrections: Corrections, balance: Balance, half: bool
) -> tuple[NDArray[np.uint16], float]:
    """(H, W, 3), or half its size, linear; and the value that _FULL stands for, 1 at white."""
    import rawpy

    width, height = raw.sizes.width, raw.sizes.height
    headroom, white = _prepare(raw, corrections)
    if half:
        centre_colours(raw.raw_image_visible, raw.raw_colors_visible[:2, :2])
    developed = raw.postprocess(
        gamma=(1, 1),
        no_auto_bright=True,
        output_bps=16,
        output_color=rawpy.ColorSpace.raw if corrections.color else rawpy.ColorSpace.sRGB,
        user_wb=[*balance, balance[1]],
        adjust_maximum_thr=0,
        user_flip=0,
        half_size=half,
        user_sat=white,
    )[: height // 2 if half else height, : width // 2 if half else width]
    return developed, headroom


def _opened(path: Path, rewritten: bytes | None) -> LibRaw:
    """A RAW file opened by LibRaw, or what it has been rewritten to."""
    import rawpy

    try:
        return rawpy.imread(str(path) if rewritten is None else io.BytesIO(rewritten))
    except rawpy.LibRawFileUnsupportedError as error:
        raise MatcapError.at(
            path,
            "this RAW file is damaged, or of a kind that LibRaw does not know",
            "copy it from the camera again, or convert it to DNG",
        ) from error


def _check_levels(path: Path, raw: LibRaw) -> None:
    if raw.num_colors != 3:
        raise MatcapError.at(
            path,
            f"the camera sees {raw.num_colors} colours, not red, green and blue",
            "give a developed picture, a TIFF say",
        )
    if raw.white_level <= max(raw.black_level_per_channel):
        raise unreadable(path, "RAW")


def _saturated(
    raw: LibRaw, balance: Balance, bayer: bool, half: bool
) -> tuple[NDArray[np.bool_], float]:
    """(H, W) mask, or half its size, of developed pixels that depend on clipped photosites.

    Also the share of clipped photosites, of the colour with the largest one. A channel with a
    white-balance gain above 1 is clipped by LibRaw at the white level divided by the gain.
    """
    mosaic = raw.raw_image_visible
    lift = np.array([*balance, balance[1]])
    black = np.array(raw.black_level_per_channel, np.float64)
    limit = black + CLIP_SHARE * (raw.white_level - black) / lift
    if mosaic.ndim == 3:
        stacked: NDArray[np.bool_] = (mosaic[..., :3] >= limit[:3]).any(axis=-1)
        return stacked, float(stacked.mean())
    colors = raw.raw_colors_visible
    period = 2 if bayer else 6
    mask = np.empty(mosaic.shape, np.uint8)
    at_limit, sites_of = np.zeros(4), np.zeros(4)
    for row, column in product(range(period), repeat=2):
        sites, color = np.s_[row::period, column::period], colors[row, column]
        mask[sites] = mosaic[sites] >= limit[color]
        at_limit[color] += np.count_nonzero(mask[sites])
        sites_of[color] += mask[sites].size
    share = float((at_limit / np.maximum(sites_of, 1.0)).max())
    touched = np.asarray(cv2.dilate(mask, np.ones((3, 3), np.uint8)), np.uint8)
    if half:  # a pixel of the result is 2 x 2 of these
        rows, columns = (side // 2 * 2 for side in touched.shape)
        touched = touched[:rows, :columns].reshape(rows // 2, 2, columns // 2, 2).max(axis=(1, 3))
    return touched.astype(np.bool_), share


def _balance(raw: LibRaw, corrections: Corrections) -> tuple[Balance, str]:
    """White-balance gains of red, green and blue, the least 1; and a note to the user, or ""."""
    note = ""
    if corrections.color is not None:
        red, green, blue = (1.0 / channel for channel in corrections.color.neutral)
        note = corrections.color.note
    elif (stated := _positive(raw.camera_whitebalance)) is not None:
        red, green, blue = stated
    else:
        daylight = _positive(raw.daylight_whitebalance)
        red, green, blue = daylight or (1.0, 1.0, 1.0)
        what = (
            "daylight assumed" if daylight else "and nothing is known of the camera: none applied"
        )
        note = f"The file states no white balance: {what}."
    if corrections.color is None and not _knows_colours(raw):
        note = f"{note} {_OWN_COLOURS}".strip()
    least = min(red, green, blue)
    return (red / least, green / least, blue / least), note


def _knows_colours(raw: LibRaw) -> bool:
    """Whether LibRaw has a colour matrix of this camera."""
    own = np.asarray(raw.color_matrix)[:, :3]
    return bool(np.any(raw.rgb_xyz_matrix) or (np.any(own) and not np.allclose(own, np.eye(3))))


def _positive(balance: Sequence[float]) -> Balance | None:
    """The first three factors, if positive; LibRaw returns zeros if unknown."""
    red, green, blue = balance[:3]
    return (red, green, blue) if min(red, green, blue) > 0 else None


def _shading(maps: tuple[GainMap, ...], corrections: Corrections, raw: LibRaw) -> Shading:
    """Gain maps for LibRaw's visible area, which may begin a pixel after the active area."""
    sizes = raw.sizes
    size = (sizes.height, sizes.width)
    visible = (sizes.top_margin, sizes.left_margin)
    whole = (*visible, visible[0] + size[0], visible[1] + size[1])
    top, left, bottom, right = corrections.active_area or whole
    offset = (visible[0] - top, visible[1] - left)
    return Shading(maps, (bottom - top, right - left), size, offset)


def _prepare(raw: LibRaw, corrections: Corrections) -> tuple[float, int | None]:
    """Apply lens shading to the mosaic in place.

    OpcodeList3's maps are defined for the demosaiced picture. As they vary slowly, they are applied
    to the photosites of each colour instead, because LibRaw would clip the demosaiced picture.

    Returns:
        The value that a developed 1 stands for, in units of the file's white level; and the white
        level to develop with, None for the file's.
    """
    samples = raw.raw_image_visible
    flat = samples.ndim == 2
    black = np.array(raw.black_level_per_channel, np.float64)[: 4 if flat else 3]
    if not corrections.has_maps:
        # LibRaw does not subtract the black level from the white level of demosaiced files.
        stacked = not flat and black.max() > 0
        return 1.0, int(raw.white_level - black.max()) if stacked else None
    before = _shading(corrections.on_mosaic.gain_maps, corrections, raw)
    after = _shading(corrections.after_demosaic.gain_maps, corrections, raw)
    headroom = before.largest(1 if flat else 3) * after.largest(3)
    # Scaled to 16 bits, so that gains neither clip nor lose precision.
    white_at = raw.white_level - black.min()
    stretch = (_FULL - black.max()) / (white_at * headroom)
    colors = raw.raw_colors_visible if flat else None
    step = max(1, _STRIP_PHOTOSITES // samples.shape[1])
    for top in range(0, samples.shape[0], step):
        bottom = min(top + step, samples.shape[0])
        gains = after.gains(top, bottom, 3)
        if colors is None:
            stored, base = samples[top:bottom, :, :3], black
            gains *= before.gains(top, bottom, 3)
        else:
            color = colors[top:bottom]
            stored, base = samples[top:bottom], black[color]
            of_color = np.where(color == 3, 1, color)[..., None]  # LibRaw's second green
            gains = np.take_along_axis(gains, of_color, axis=2)[..., 0]
            gains *= before.gains(top, bottom, 1)[..., 0]
        stored[...] = np.clip(np.rint(base + (stored - base) * (gains * stretch)), 0, _FULL)
    # LibRaw sets this white level after it has subtracted black.
    return headroom, round(white_at * stretch * headroom)
