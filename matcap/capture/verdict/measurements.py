"""Measured differences between a photograph and its re-rendering: light, highlight, texture."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.rectified import FEATURES, WINDOW, code_step
from matcap.capture.verdict.causes import (
    UNSEEN,
    ExemplarMeasurements,
    HighlightProfile,
    by_place,
    highlight_profile,
    measure_causes,
)
from matcap.files.threads import at_once
from matcap.flash.geometry import FlashSetup, points_of
from matcap.flash.highlight import Highlight, find_highlight, light_of
from matcap.flash.light import shade
from matcap.flash.rectify import Plane, plane_of
from matcap.photo.checks import Region
from matcap.photo.inspect import (
    Inspection,
    band_passed,
    channel_mean,
    inspect_photo,
    largest_tile,
    upright_region,
)
from matcap.photo.left_out import cell_means
from matcap.photo.photo import FULL, Photo
from matcap.statistics.compare import Descriptor, FilterBank, Weights, describe, distance
from matcap.statistics.lattice import Wave, periodicity

Picture = NDArray[np.float32]
TexelMask = NDArray[np.bool_]

# Filters and windows of the comparison; docs/notes/verdict.md.
_CELLS = 64  # cells across the low-pass filtered pictures
# Standard deviation of the low-pass, cells: shorter wavelengths are texture, not light.
_SMOOTH = 2.0
_TOE = 0.02  # share of the median that is added before logarithms
# A channel's least median, share of all channels' mean: what a darker one lacks is added to it, as
# the green of a blue paint, 1 % of its blue, may double unseen.
_LEAST_CHANNEL = 0.25
_SPARSE = 4  # every so many texels along each axis tell of a channel's median
# Standard deviations, texels, of the two Gaussians of the band-pass for fine texture.
_FINE = (1.0, 3.0)
_COARSE_BAND = (4.0, 16.0)  # standard deviations of the band-pass for coarse texture, texels
_CHROMA_BAND = (2.0, 16.0)  # those for coloured texture, log red / green and blue / green
_SPOT_BAND = (1.0, 4.0)  # standard deviations of the band-pass for single spots, texels
_DEEPEST = 0.005  # quantile of it, from either end, that is the depth of the spots
_SHALLOW = 0.05  # depth, log luminance, that nobody sees of a single spot
# Position of lights, plane units: to the left of the sample, and above; grazing, to show relief.
SIDES = {"left": (-2.5, 0.0, 1.5), "top": (0.0, 2.0, 1.2)}
LIT = 1024  # texels along the long side that are rendered under them, at least
_PATCH_TILES = 16  # across the picture, for directions
_AROUND = 1.5  # standard deviation of what is around a tile, tiles
_UNSEEN_CODES = 2.0  # of 255, in which a developed photograph is uncertain
_TILES = 8  # across the picture, for contrasts of texture
_BRIGHT = 0.2  # share of tiles, the brightest, that form the region in the light
_PLACES = (4, 3)  # number of windows across and down
_AT_ONCE = 4  # windows whose features, 11 MB each, are in memory
_LEAST_SEEN = 0.5  # least valid share of a window
_LEAST_MARK = 0.1  # half the side of the least square that is shown, plane units


@dataclass(frozen=True)
class Measurements:
    """Measurements of a capture; pairs are of the photograph and its re-rendering."""

    photograph: Inspection
    """Checks of the photograph by `matcap inspect`."""
    highlights: tuple[Highlight | None, Highlight | None]
    """Detected highlights, or None."""
    profile: HighlightProfile | None
    """Radial profile of the highlight; None if the mirror point is outside of the picture."""
    colour: tuple[float, float, float]
    """(3,) log of re-rendering over photograph by channel, median over cells."""
    light: float
    """Root-mean-square difference of log luminance that varies with position as light does (linear,
    or by distance from the centre)."""
    texture: float = math.nan
    """Texture distance between re-rendering and photograph over that between neighbouring parts of
    the photograph; NaN if that is too small."""
    contrast: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """By band and region: root-mean-square log luminance of the texture."""
    order: tuple[float, float] | None = None
    """Autocorrelation at a lag of one period, at most 1; None without a lattice."""
    exemplar: ExemplarMeasurements = ExemplarMeasurements()
    """Measurements on the exemplar itself."""
    causes: Mapping[str, float] = field(default_factory=dict)
    """Measurement of each cause by its name (photo/checks.py)."""
    photographs: int = 1
    """Number of photographs of the sample."""
    spots: float = 1.0
    """Depth of the brightest spots over that of the darkest, re-rendered over photographed, in the
    light or outside: above 1 specks, below 1 pits; 1 where clipped."""
    patches: float = math.nan
    """Patchiness of the field lit from the sides over the exemplar's (patchiness)."""
    itself: Measurements | None = None
    """Those of the exemplar itself, not rearranged; None without one."""
    regions: Mapping[str, Region] = field(default_factory=dict)
    """Where it is seen, by `highlight`, `texture`, `spots` and band of contrast, in the upright
    picture."""

    def of_texture(
        self,
        photo: Photo,
        pictures: tuple[Picture, Picture],
        valid: TexelMask,
        waves: tuple[Wave, ...] = (),
    ) -> Measurements:
        """With the texture of `pictures`, photograph and re-rendering, clipped alike."""
        developed = not (photo.radiometric or photo.floating)
        linear, rendering = (torch.from_numpy(each).movedim(-1, 0) for each in pictures)
        plane = plane_of(linear, torch.from_numpy(valid), headroom=photo.headroom)

        def of_contrast() -> tuple[dict[str, tuple[float, float]], dict[str, Region]]:
            tiles = tile_contrasts(pictures[0]), tile_contrasts(pictures[1])
            return texture_contrasts(pictures[0], tiles, developed=developed)

        (texture, regions), (contrast, where), (spots, spot) = at_once(
            partial(texture_difference, plane, rendering),
            of_contrast,
            partial(uneven_spots, pictures, valid),
        )
        regions |= where | spot
        return replace(
            self,
            texture=texture,
            contrast=contrast,
            order=_order(plane, rendering, waves) if waves else None,
            spots=spots,
            regions={name: upright_region(photo, region) for name, region in regions.items()},
        )


def measure_capture(
    photo: Photo,
    setup: FlashSetup,
    rectified: Picture,
    rerendered: Picture,
    valid: TexelMask,
    waves: tuple[Wave, ...] = (),
    exemplar: ExemplarMeasurements | None = None,
    inspected: Inspection | None = None,
) -> Measurements:
    """Measure the differences between a photograph and its re-rendering.

    Args:
        rectified: (H, W, 3) the photograph on the plane's grid, linear.
        rerendered: (H, W, 3) the material under that flash, linear.
        valid: (H, W) bool, visible and not clipped.
        waves: frequency vectors of its lattice, cycles per texel.
        exemplar: measurements on the exemplar, if there is one.
        inspected: the photograph's checks, with those of its highlight; by default without.
    """
    exemplar = exemplar or ExemplarMeasurements()
    # Both are clipped at the camera's limit.
    limit = photo.headroom
    pictures = clipped_at(rectified, limit), clipped_at(rerendered, limit)
    smooth = _smooth(pictures[0]), _smooth(pictures[1])
    colour, light = smooth_difference(*smooth)
    highlights = find_highlight(light_of(pictures[0])), find_highlight(light_of(pictures[1]))
    inside = valid | (rectified > FULL * limit).any(axis=2)
    measured = Measurements(
        photograph=inspected or inspect_photo(photo, setup.tilt),
        highlights=highlights,
        profile=highlight_profile(pictures, inside, valid, setup, limit),
        colour=colour,
        light=light,
        exemplar=exemplar,
        causes=measure_causes(smooth, pictures, highlights, exemplar),
    )
    measured = measured.of_texture(photo, pictures, valid, waves)
    if (seen := highlights[0] or highlights[1]) is None:
        return measured
    around = upright_region(photo, _around(seen, rectified.shape))
    return replace(measured, regions={**measured.regions, "highlight": around})


def clipped_at(picture: Picture, limit: float) -> Picture:
    """A picture's radiance up to `limit`: itself, no copy, where none exceeds it."""
    return picture if picture.max() <= limit else np.minimum(picture, np.float32(limit))


def _around(highlight: Highlight, shape: tuple[int, ...]) -> Region:
    """Square around a highlight, in shares of a picture (H, W)."""
    half, up = max(highlight.width, _LEAST_MARK), shape[0] / shape[1]
    x, y = highlight.centre
    return (1.0 + x - half) / 2.0, (up - y - half) / (2.0 * up), half, half / up


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
    median = np.median(before, axis=(0, 1))
    toe = np.maximum(_TOE * median + 1e-6, _lacking(median))
    ratio = np.median(np.log((after + toe) / (before + toe)), axis=(0, 1))
    light, lit = before.mean(axis=2), after.mean(axis=2)
    floor = _toe(light)
    rest = by_place(np.log((lit + floor) / (light + floor)))
    return (float(ratio[0]), float(ratio[1]), float(ratio[2])), float(rest.std())


def _lacking(median: NDArray[Any]) -> NDArray[Any]:
    """What each channel's median (3,) lacks of the least that is seen."""
    return np.asarray(_LEAST_CHANNEL * median.mean() - median)


def texture_contrasts(
    seen: Picture, tiles: tuple[dict[str, Picture], dict[str, Picture]], *, developed: bool = False
) -> tuple[dict[str, tuple[float, float]], dict[str, Region]]:
    """Root-mean-square contrast of log luminance, and of colour, in two linear pictures (H, W, 3),
    and the tile of which the contrast differs most in the direction of all.

    `seen` is the photograph, `tiles` are of it and of its re-rendering (tile_contrasts).

    By band, and by region: the photograph's brightest tiles ("in the light", where gloss reveals
    relief) and the others. Medians over tiles, robust to the gradient of a highlight. A developed
    photograph is uncertain by a code of 255, which blurs to blotches of colour, and is most of what
    a black sample shows: that variance is added to both, so that only visible differences count.
    """
    bright = _bright_tiles(seen)
    before, after = tiles
    if developed:
        noise = _code_variance(seen)
        before, after = ({band: each[band] + noise[band] for band in each} for each in tiles)

    contrast, places = {}, {}
    for band in before:
        change = np.log((after[band] + UNSEEN**2) / (before[band] + UNSEEN**2))
        for where, region in (("in the light", bright), ("beside the light", ~bright)):
            name = f"{band} texture {where}"
            of = (math.sqrt(float(np.median(tile[region]))) for tile in (before[band], after[band]))
            contrast[name] = (next(of), next(of))
            grown = change if contrast[name][1] > contrast[name][0] else -change
            places[name] = largest_tile(np.where(region, grown, -np.inf))
    return contrast, places


def uneven_spots(
    pictures: tuple[Picture, Picture], valid: TexelMask
) -> tuple[float, dict[str, Region]]:
    """Depth of the brightest spots over that of the darkest, re-rendered over photographed, where
    it differs most, in the light or outside; and the place of most of them.

    Medians over tiles leave out what few texels show: white specks of a glint that are rendered
    everywhere, black pits. 1 and none where the picture is clipped.

    Args:
        pictures: (H, W, 3) linear, photograph and re-rendering.
        valid: (H, W) bool, inside of the photograph and not clipped.
    """
    bands = [band_passed(_log_luminance(each), *_SPOT_BAND) for each in pictures]
    lit = _bright_tiles(pictures[0]).astype(np.uint8)
    bright = cv2.resize(lit, valid.shape[::-1], interpolation=cv2.INTER_NEAREST).astype(bool)
    strongest, places = 1.0, {}
    for seen in (bright & valid, ~bright & valid):
        if seen.mean() < _BRIGHT * _LEAST_SEEN:
            continue
        (dark, high), (darker, higher) = (_depths(band[seen]) for band in bands)
        ratio = higher / darker / (high / dark)
        if abs(math.log(ratio)) > abs(math.log(strongest)):
            shown = bands[1] > higher - _SHALLOW if ratio > 1.0 else bands[1] < _SHALLOW - darker
            strongest = ratio
            places = {"spots": largest_tile(cell_means((seen & shown).astype(np.float32), _TILES))}
    return strongest, places


def _depths(band: Picture) -> tuple[float, float]:
    """Depth of the darkest spots of a band, and of the brightest."""
    low, high = np.quantile(band, (_DEEPEST, 1.0 - _DEEPEST))
    return max(-float(low), 0.0) + _SHALLOW, max(float(high), 0.0) + _SHALLOW


# Of maps lit from the sides, as nobody has photographed them.


def lit_from(
    side: str,
    maps: MapSet,
    setup: FlashSetup,
    rows: slice = slice(None),
    columns: slice = slice(None),
) -> Picture:
    """(h, w, 3) radiance of texels of maps under a light of SIDES, from the photograph's camera."""
    points = points_of(maps.size[::-1], rows, columns=columns)
    if setup.turned:
        points *= maps.size[0] / maps.size[1]  # the long side is two plane units, here upwards
    camera, light = torch.tensor([0.0, 0.0, setup.distance]), torch.tensor(SIDES[side])
    with torch.no_grad():
        radiance = shade(texels_of(maps, rows, columns), points, camera, light, torch.ones(3))
    return np.ascontiguousarray(radiance.movedim(0, -1).numpy())


def texels_of(maps: MapSet, rows: slice, columns: slice) -> MapSet:
    """Some texels of maps, with the normals that they have among all; computed by strips."""
    step, (first, last, _) = rows.step or 1, rows.indices(maps.size[1])
    parts = (slice(top, min(top + step * 64, last)) for top in range(first, last, step * 64))
    normal = torch.cat([maps.normals_of(part)[..., ::step, columns] for part in parts], dim=-2)
    some = replace(maps, painted=None).map(lambda planes: planes[..., rows, columns])
    return replace(some, painted=normal)


def lit_from_sides(maps: MapSet, setup: FlashSetup) -> tuple[Picture, ...]:
    """Maps under all lights of SIDES, thinned to LIT texels along the long side or more."""
    every = slice(None, None, max(1, max(maps.size) // LIT))
    return tuple(lit_from(side, maps, setup, every, every) for side in SIDES)


def patchiness(picture: Picture) -> float:
    """How much the direction of the finest texture differs from that around, root-mean-square.

    Directions are (Gxx - Gyy, 2 Gxy) / (Gxx + Gyy) of the structure tensor of log luminance, in
    [-1, 1], of _PATCH_TILES across: patches lit along different directions are a quilt.
    """
    down, across = np.gradient(cv2.GaussianBlur(_log_luminance(picture), (0, 0), 1.0))
    tiles = [
        cell_means(product, _PATCH_TILES)
        for product in (across * across, down * down, across * down)
    ]
    total = tiles[0] + tiles[1] + 1e-6
    variance = 0.0
    for direction in ((tiles[0] - tiles[1]) / total, 2.0 * tiles[2] / total):
        around = cv2.GaussianBlur(direction, (0, 0), _AROUND, borderType=cv2.BORDER_REFLECT)
        variance += float(np.square(direction - around).mean())
    return math.sqrt(variance)


def _bright_tiles(picture: Picture) -> NDArray[np.bool_]:
    """Which of a picture's tiles are its brightest."""
    light = cell_means(channel_mean(picture), _TILES)
    bright = np.zeros(light.shape, bool)
    bright.flat[light.argsort(axis=None)[-math.ceil(_BRIGHT * light.size) :]] = True
    return bright


def tile_contrasts(picture: Picture) -> dict[str, Picture]:
    """By band, variance of log luminance in each tile."""

    def variance(log: Picture, reach: tuple[float, float]) -> Picture:
        band = band_passed(log, *reach)
        return cell_means(np.square(band, out=band), _TILES)

    log = _log_luminance(picture)
    tiles = {"fine": variance(log, _FINE), "coarse": variance(log, _COARSE_BAND)}
    log = picture + _floors(picture)
    log = np.log(log, out=log)
    log = log[..., ::2] - log[..., 1:2]
    return {**tiles, "coloured": variance(log, _CHROMA_BAND).mean(axis=2)}


def _code_variance(picture: Picture) -> dict[str, Picture]:
    """By band, variance in each tile by an error of _UNSEEN_CODES: of log luminance, all channels
    alike, and of log red / green and blue / green, each for itself. `picture` is linear.
    """
    tiles = cell_means(picture, _TILES)
    grey = channel_mean(tiles)
    luminance = np.square(_UNSEEN_CODES * code_step(grey) / (grey + _toe(channel_mean(picture))))
    variance = np.square(_UNSEEN_CODES * code_step(tiles) / (tiles + _floors(picture)))
    coloured = np.asarray(variance[..., ::2].mean(axis=2) + variance[..., 1])
    return {"fine": luminance, "coarse": luminance, "coloured": coloured}


def _toe(light: NDArray[np.floating]) -> float:
    """What is added to light before its logarithm."""
    return _TOE * float(np.median(light)) + 1e-6


def _log_luminance(picture: Picture) -> Picture:
    """Log luminance of a picture (H, W, 3), with a toe."""
    luminance = channel_mean(picture)
    return np.asarray(np.log(luminance + _toe(luminance)))


def _floors(picture: Picture) -> Picture:
    """(3,) radiance added to each channel of a picture (H, W, 3) before the logarithm."""
    some = picture[::_SPARSE, ::_SPARSE]
    return np.maximum(_toe(channel_mean(some)), _lacking(np.median(some, axis=(0, 1)))).astype(
        np.float32
    )


def _smooth(picture: Picture) -> NDArray[np.float64]:
    """Low-pass filtered picture (H, W, 3), _CELLS across."""
    small = cell_means(picture, _CELLS, 4)
    smooth = cv2.GaussianBlur(small, (0, 0), _SMOOTH, borderType=cv2.BORDER_REFLECT)
    return np.asarray(smooth, np.float64)


def texture_difference(plane: Plane, rendering: Tensor) -> tuple[float, dict[str, Region]]:
    """Texture distance of a rendering, relative to that between parts of the photograph.

    Args:
        rendering: (3, H, W) linear.

    Returns:
        median distance of texture statistics (statistics/compare.py) between rendering and
        photograph at the same places over that between neighbouring places of the photograph;
        without mean colours; and the place, as `texture`, where a rendering's is largest. NaN and
        none if the picture is too small.
    """
    width, height = plane.size
    places = [
        (x, y)
        for y in _spread(height - WINDOW, _PLACES[1])
        for x in _spread(width - 2 * WINDOW, _PLACES[0])
        if plane.valid[y : y + WINDOW, x : x + 2 * WINDOW].float().mean() > _LEAST_SEEN
    ]
    if not places:
        return math.nan, {}
    bank, weights = FilterBank(FEATURES), Weights(mean=0.0)

    def described(picture: Tensor, shift: int) -> Descriptor:
        cut = [picture[:, y : y + WINDOW, x + shift :][..., :WINDOW] for x, y in places]
        some = (cut[first : first + _AT_ONCE] for first in range(0, len(cut), _AT_ONCE))
        linear = (torch.stack([each.contiguous() for each in part]) for part in some)
        return Descriptor.joined([describe(part, plane.encoding, bank) for part in linear])

    with torch.inference_mode():
        here, neighbour, there = at_once(
            partial(described, plane.linear, 0),
            partial(described, plane.linear, WINDOW),
            partial(described, rendering, 0),
        )
        own = float(distance(neighbour, here, weights).median())
        differs = distance(there, here, weights)
    x, y = places[int(differs.argmax())]
    region = (x / width, y / height, WINDOW / width, WINDOW / height)
    return float(differs.median()) / max(own, 1e-6), {"texture": region}


def _spread(room: int, count: int) -> list[int]:
    """`count` evenly spaced integers from 0 to `room`; none if that is negative."""
    return [round(i * room / (count - 1)) for i in range(count)] if room >= 0 else []


def _order(plane: Plane, rendering: Tensor, waves: tuple[Wave, ...]) -> tuple[float, float]:
    """Autocorrelation at a lag of one lattice period, of photograph and re-rendering."""
    return (
        periodicity(plane.encoded(), plane.valid, waves),
        periodicity(plane.encoding(rendering[None])[0], plane.valid, waves),
    )
