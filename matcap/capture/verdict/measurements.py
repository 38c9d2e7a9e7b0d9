"""Measured differences between a photograph and its re-rendering: light, highlight, texture.

Read next: findings.py, which rates them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.capture.method import FEATURES
from matcap.capture.verdict.causes import CauseMeasurements, by_place
from matcap.capture.verdict.highlight import HighlightProfile, highlight_profile
from matcap.flash.geometry import FlashSetup
from matcap.flash.highlight import Highlight, find_highlight, light_of
from matcap.flash.plane import Plane, plane_of
from matcap.flash.rectify import CLIPPING
from matcap.photo.inspect import Inspection, inspect_photo
from matcap.photo.photo import Photo
from matcap.statistics.compare import Descriptor, Weights, describe, distance
from matcap.statistics.filterbank import FilterBank
from matcap.statistics.lattice import Wave, periodicity

Picture = NDArray[np.float32]
TexelMask = NDArray[np.bool_]


@dataclass(frozen=True)
class MeasurementSettings:
    """How photograph and re-rendering are looked at; docs/notes/verdict.md."""

    cells: int = 64
    """Across the long side, of what is smooth."""
    smooth: float = 2.0
    """Cells, deviation: a sixteenth of the picture is light, less is texture."""
    toe: float = 0.02
    """Of the median: bounds logarithms in the dark."""
    fine: tuple[float, float] = (1.0, 3.0)
    """Texels, deviations of the blurs on either side of a band of texture."""
    coarse: tuple[float, float] = (4.0, 16.0)
    """Likewise."""
    chroma: tuple[float, float] = (2.0, 16.0)
    """Likewise, of log red and blue over green."""
    bright: float = 0.2
    """Share of tiles that are looked at by themselves, the brightest."""
    window: int = 160
    """Texels a side of the windows whose texture is compared."""
    places: tuple[int, int] = (4, 3)
    """Windows across and down."""
    least_seen: float = 0.5
    """Share of a window that must be seen."""


MEASURED = MeasurementSettings()


@dataclass(frozen=True)
class PieceMeasurements:
    """What a capture says of the photographed piece, before anything is compared."""

    maps: Mapping[str, float] | None = None
    residue: Mapping[str, float] | None = None
    """Both as of Measurements."""
    tilt: float = 0.0
    variety: float = 1.0
    photographs: int = 1
    """All three as of CauseMeasurements."""


@dataclass(frozen=True)
class Measurements:
    """Of a capture; pairs are of the photograph and of its re-rendering."""

    photograph: Inspection
    """What `inspect` finds in it."""
    highlights: tuple[Highlight | None, Highlight | None]
    """None where nothing stands out."""
    profile: HighlightProfile | None
    """Of the highlight in rings; None where its mirror point is not in the picture."""
    colour: tuple[float, float, float]
    """(3,) log of re-rendering over photograph, median over cells, by channel."""
    light: float
    """Root-mean-square difference of log luminance that goes with place, as light does: across the
    picture, and with distance from its middle."""
    texture: float
    """Difference of texture statistics between re-rendering and photograph, in multiples of what
    neighbouring parts of the photograph differ by; NaN where it has none."""
    contrast: Mapping[str, tuple[float, float]]
    """By band and region, root-mean-square log luminance of the texture."""
    order: tuple[float, float] | None
    """Likeness to themselves a period further, each at most 1; None without a regular order."""
    offset: float
    """Of the flash from the lens, plane units."""
    piece: Mapping[str, float] | None = None
    """Of the photographed piece's own maps: `error`, `slow` (log radiance) and confidence by map;
    None where they were not looked for."""
    residue: Mapping[str, float] | None = None
    """Radial variation of the piece's maps about the mirror point; see residue.py."""
    causes: CauseMeasurements = CauseMeasurements()
    """Of what may be the cause of all that."""


def measured(
    photo: Photo,
    setup: FlashSetup,
    rectified: Picture,
    rerendered: Picture,
    valid: TexelMask,
    waves: tuple[Wave, ...] = (),
    piece: PieceMeasurements | None = None,
) -> Measurements:
    """Measure a capture, in about a second.

    Args:
        photo: the photograph.
        setup: its camera and flash, as fitted.
        rectified: (H, W, 3) the photograph on the plane's grid, linear.
        rerendered: (H, W, 3) the material under that flash, linear.
        valid: (H, W) bool, texels seen by the camera and not clipped.
        waves: the plane waves of its regular order, cycles a texel.
        piece: of the photographed piece's own maps.
    """
    piece = piece or PieceMeasurements()
    # What the camera would have seen of the re-rendering: clipped where the photograph is.
    pictures = np.minimum(rectified, 1.0), np.minimum(rerendered, 1.0)
    smooth = _smooth(pictures[0]), _smooth(pictures[1])
    colour, light = smooth_difference(*smooth)
    highlights = find_highlight(light_of(pictures[0])), find_highlight(light_of(pictures[1]))
    inside = valid | (rectified.max(axis=2) > CLIPPING)
    plane = plane_of(_planes(pictures[0]), torch.from_numpy(valid))
    rendering = _planes(pictures[1])
    causes = CauseMeasurements(
        tilt=piece.tilt,
        variety=piece.variety,
        developed=not photo.radiometric,
        fired=photo.flash_fired,
        photographs=piece.photographs,
    )
    return Measurements(
        photograph=inspect_photo(photo, setup.tilt),
        highlights=highlights,
        profile=highlight_profile(pictures, inside, valid, setup),
        colour=colour,
        light=light,
        texture=texture_difference(plane, rendering),
        contrast=texture_contrasts(*pictures),
        order=_order(plane, rendering, waves) if waves else None,
        offset=math.hypot(*setup.offset[:2]),
        piece=piece.maps,
        residue=piece.residue,
        causes=causes.with_photograph(photo.pixels, smooth, pictures, highlights),
    )


def smooth_difference(
    before: NDArray[np.float64], after: NDArray[np.float64]
) -> tuple[tuple[float, float, float], float]:
    """Colour and light differences of two low-pass filtered pictures, (h, w, 3) each.

    Only the part of the difference that varies with position as light does counts (by_place): large
    veins or patches are low-frequency too, and lie elsewhere in a synthesised field.

    Returns:
        median log ratio of each channel, and root-mean-square of the remaining difference of log
        luminance by light.
    """
    toe = MEASURED.toe * np.median(before, axis=(0, 1)) + 1e-6
    ratio = np.median(np.log((after + toe) / (before + toe)), axis=(0, 1))
    light, lit = before.mean(axis=2), after.mean(axis=2)
    floor = MEASURED.toe * float(np.median(light)) + 1e-6
    difference = np.log((lit + floor) / (light + floor))
    rest = by_place(difference)
    return (float(ratio[0]), float(ratio[1]), float(ratio[2])), float(rest.std())


def texture_contrasts(seen: Picture, again: Picture) -> dict[str, tuple[float, float]]:
    """Root-mean-square contrast of log luminance in two linear pictures (H, W, 3).

    By band, and by region: the photograph's brightest tiles ("in the light", where gloss reveals
    relief) and the others. Medians over tiles, robust to the gradient of a highlight.
    """
    light = _tiles(seen.mean(axis=2))
    bright = np.zeros(light.shape, bool)
    bright.flat[light.argsort(axis=None)[-math.ceil(MEASURED.bright * light.size) :]] = True
    before, after = (_tile_contrasts(picture) for picture in (seen, again))

    def of(tiles: Picture, region: NDArray[np.bool_]) -> float:
        return math.sqrt(float(np.median(tiles[region])))

    return {
        f"{band} texture {where}": (of(before[band], region), of(after[band], region))
        for band in before
        for where, region in (("in the light", bright), ("beside the light", ~bright))
    }


def _tile_contrasts(picture: Picture) -> dict[str, Picture]:
    """By band, variance of log luminance in each tile."""
    luminance = picture.mean(axis=2)
    log = np.log(luminance + MEASURED.toe * float(np.median(luminance)) + 1e-6)
    bands = {"fine": MEASURED.fine, "coarse": MEASURED.coarse}
    tiles = {band: _tiles(np.square(_band(log, *reach))) for band, reach in bands.items()}
    whole = np.log(picture + MEASURED.toe * float(np.median(luminance)) + 1e-6)
    chroma = _band(whole[..., ::2] - whole[..., 1:2], *MEASURED.chroma)
    return {**tiles, "coloured": _tiles(np.square(chroma).mean(axis=2))}


def _band(log: Picture, least: float, most: float) -> Picture:
    fine, wide = (cv2.GaussianBlur(log, (0, 0), deviation) for deviation in (least, most))
    return np.asarray(fine - wide, np.float32)


def _tiles(picture: Picture) -> Picture:
    rows = max(1, round(8 * picture.shape[0] / picture.shape[1]))
    return np.asarray(cv2.resize(picture, (8, rows), interpolation=cv2.INTER_AREA), np.float32)


def _smooth(picture: Picture) -> NDArray[np.float64]:
    rows = max(4, round(MEASURED.cells * picture.shape[0] / picture.shape[1]))
    small = cv2.resize(picture, (MEASURED.cells, rows), interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(small, (0, 0), MEASURED.smooth, borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred, np.float64)


def texture_difference(plane: Plane, rendering: Tensor) -> float:
    """Texture distance of a rendering, relative to that between parts of the photograph.

    Args:
        plane: the photograph.
        rendering: (3, H, W) linear.

    Returns:
        median distance of texture statistics (statistics/compare.py) between rendering and
        photograph at the same places over that between neighbouring places of the photograph;
        without mean colours. NaN where the picture is too small.
    """
    width, height = plane.size
    places = [
        (x, y)
        for y in _spread(height - MEASURED.window, MEASURED.places[1])
        for x in _spread(width - 2 * MEASURED.window, MEASURED.places[0])
        if plane.valid[y : y + MEASURED.window, x : x + 2 * MEASURED.window].float().mean()
        > MEASURED.least_seen
    ]
    if not places:
        return math.nan
    bank, weights = FilterBank(FEATURES), Weights(mean=0.0)

    def described(picture: Tensor, shift: int) -> Descriptor:
        cut = [
            picture[:, y : y + MEASURED.window, x + shift :][..., : MEASURED.window]
            for x, y in places
        ]
        return describe(torch.stack(cut), plane.encoding, bank)

    with torch.inference_mode():
        here, neighbour = described(plane.linear, 0), described(plane.linear, MEASURED.window)
        there = described(rendering, 0)
        own = float(distance(neighbour, here, weights).median())
        return float(distance(there, here, weights).median()) / max(own, 1e-6)


def _spread(room: int, count: int) -> list[int]:
    """Evenly spaced places from 0 to `room`; none where there is no room."""
    return [round(i * room / (count - 1)) for i in range(count)] if room >= 0 else []


def _planes(picture: Picture) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(picture.transpose(2, 0, 1)))


def _order(plane: Plane, rendering: Tensor, waves: tuple[Wave, ...]) -> tuple[float, float]:
    """Autocorrelation at a lag of one lattice period, of photograph and re-rendering."""
    return (
        periodicity(plane.encoded(), plane.valid, waves),
        periodicity(plane.encoding(rendering[None])[0], plane.valid, waves),
    )
