"""Brackets: photographs from one place at several exposures, merged into one radiance.

Photographs are a bracket if their exposures are a stop or more apart and their cameras are less
than _NEAR of the distance apart, by the homography that aligns each to the first
(registration/one_place.py).

Values become light by the pictures' common tone curve (photo/response.py). Each pixel is then the
mean of what the photographs measure there, weighted by the inverse of their variances. Clipped and
almost clipped values are left out, and what moved or is aligned wrongly: where a photograph
deviates from the brightest unclipped one by more than _DEVIATES. A highlight moves with the camera:
on flat material as a whole, and the darker photograph's is moved back as far as the flanks of the
longer one's say; on relief as glints: near clipped places the darker one is right there, as it
alone shows all of them. What differs still is made even by a smooth factor. White is that of the
longest, and the result clips where the shortest exposure does (Photo.headroom).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.capture.registration.one_place import (
    COLUMNS,
    Matrix,
    Picture,
    alignment,
    focal_length,
    pixel_units,
    way_of_camera,
    way_of_highlight,
)
from matcap.errors import MatcapError
from matcap.files.color import srgb_slope
from matcap.files.containers import FileKind
from matcap.files.process import quiet_decoders
from matcap.photo.exif import Exif, read_exif
from matcap.photo.left_out import dilated
from matcap.photo.load import file_kind, load_photo
from matcap.photo.photo import FULL, Photo, ToneCurve
from matcap.photo.response import faintest_value, ratio_of_exposures

MOST = 5  # photographs of a bracket
MERGED = "A bracket, merged with"  # how its note begins
LEAST_STOPS, MOST_STOPS = 0.75, 7.0  # between two of them; 1 to 6, with an error of metadata
_LEAST_DARKER = 0.4  # stops between medians of values, which a shoulder brings nearer to another
_NEAR = 0.05  # way of the camera over its distance
_DETECTED = 1024  # pixels across at which photographs are compared
_MERGED = 512  # fewest across at which RAW ones are aligned as read; at 384, 3 of 8 materials fail
_FINEST = 4096  # pixels across of files of which single ones give the tone curve
# Largest difference of log light by tone, and median by pixel; a room's light has more.
_SAME_LIGHT, _SAME_PIXELS = 0.15, 0.3
_NOISY = 2.0  # pixels, standard deviation of a blur against noise
_FEWEST_LIT = 200  # pixels that both measure
_FADES = (0.8, FULL)  # of the clip level: weight falls to 0 between these
_SPREAD = 1.5  # pixels, standard deviation of the blur of clipping
_NEAR_CLIPPED = 0.5  # relative error of light that it reaches
_DEVIATES = 0.25  # log light; larger local differences are motion or misregistration
_LOCAL = 2.0  # pixels, standard deviation of their averages
_GLINT = 0.3  # light, of the longest exposure's white, from which on what moved is a glint
_GLINT_WIDTH = 4  # pixels, added to the way of the mirror point
# Of highlights: pixels of a way that counts; widths of the picture, standard deviation of the blur
# that finds one, and the innermost ring; rings per octave of radius.
_LEAST_WAY, _LOBE, _INNERMOST, _RINGS = 0.5, 1 / 32, 0.01, 4.0
_FEW_OF_RING = 20
_NOISE_AROUND = 4.0  # pixels, standard deviation of averages of its variance
_SHOT = 1.0 / 6000.0  # variance of light over light, white being 1, of a sensor that is not known


def find_brackets(paths: Sequence[Path], *, fov: float | None = None) -> list[tuple[Path, ...]]:
    """Paths in their order, those of a bracket in one tuple at the place of its first.

    Only neighbours in the order given are compared. Files that cannot be read are on their own.
    """
    groups: list[list[int]] = []
    with quiet_decoders():
        stated = [_stated(path) for path in paths] if len(paths) > 1 else []
        for number in range(len(paths)):
            group = groups[-1] if groups else []
            if (
                0 < len(group) < MOST
                and all(_may_belong(stated[number], stated[other]) for other in group)
                and _belong([paths[each] for each in (*group, number)], fov)
            ):
                group.append(number)
            else:
                groups.append([number])
    return [tuple(paths[number] for number in group) for group in groups]


def unmerged(groups: Sequence[Sequence[Path]]) -> list[tuple[Path, Path]]:
    """First files of neighbouring groups (find_brackets) that state exposures of a bracket."""
    stated = [(group[0], _stated(group[0])) for group in groups]
    return [
        (one, other)
        for (one, own), (other, next_one) in pairwise(stated)
        if own.exposure and next_one.exposure and _may_belong(own, next_one)
    ]


def _stated(path: Path) -> Exif:
    try:
        return read_exif(path)
    except OSError:
        return Exif()


def _may_belong(own: Exif, other: Exif) -> bool:
    """Whether metadata allows that two photographs belong to a bracket."""
    if own.camera != other.camera or (own.flash_fired is False) != (other.flash_fired is False):
        return False
    if own.exposure is None or other.exposure is None:
        return True
    return LEAST_STOPS < abs(math.log2(own.exposure / other.exposure)) < MOST_STOPS


def _belong(paths: Sequence[Path], fov: float | None) -> bool:
    """Whether photographs show the same from one place at several exposures."""
    try:
        return _aligns(tuple(paths), tuple(path.stat().st_mtime_ns for path in paths), fov)
    except (MatcapError, OSError):
        return False


@lru_cache(maxsize=256)
def _aligns(paths: tuple[Path, ...], _changed: tuple[int, ...], fov: float | None) -> bool:
    """Whether files are a bracket; kept until they change, as commands and captures both ask."""
    photos = [load_photo(path, long_side=_DETECTED, fov=fov, noise=False) for path in paths]
    return aligned_bracket(photos) is not None


@dataclass(frozen=True)
class _Aligned:
    """A photograph on the pixels of the first."""

    photo: Photo
    """The photograph itself."""
    pixels: Picture
    """(H, W, 3) its values, resampled."""
    inside: NDArray[np.bool_]
    """(H, W) inside of it."""
    clipped: NDArray[np.bool_]
    """(H, W)."""
    near_clipped: NDArray[np.bool_]
    """(H, W) clipped, or reached by the blur of what is."""
    noise: Picture | None
    """(H, W, 3) its noise, resampled."""
    way: float = 0.0
    """Way of its camera from the first's, over the distance."""
    homography: Matrix = field(default_factory=partial(np.eye, 3))
    """alignment() of the first with it."""
    highlight: tuple[float, float] = (0.0, 0.0)
    """Way (x, y) of its highlight from the first's, pixels."""

    @property
    def whole(self) -> Photo | None:
        """The photograph, if it has all pixels of its file and no noise is known of it."""
        whole = self.photo.clipped.size == math.prod(self.photo.original_size)
        return self.photo if whole and not self.photo.radiometric else None

    @cached_property
    def glint_reach(self) -> int:
        """Pixels by which glints may be elsewhere than in the first photograph."""
        way = self.way * focal_length(self.photo.fov) * self.pixels.shape[1]
        return _GLINT_WIDTH + math.ceil(way)


@dataclass(frozen=True)
class Bracket:
    """Photographs on the pixels of the first given, with their light."""

    views: tuple[_Aligned, ...]
    """In the order given."""
    factors: tuple[float, ...]
    """Light of the longest exposure over that of each, at least 1."""
    curves: tuple[ToneCurve, ...]
    """Tone curve of each."""

    def of(self, photos: Sequence[Photo]) -> Bracket:
        """The bracket of its photographs at another resolution, without their curves."""
        homographies = [view.homography for view in self.views]
        linear = (ToneCurve(),) * len(photos)
        return replace(self, views=_views(photos, homographies, sampled=False), curves=linear)

    def light(self, number: int) -> Picture:
        """(H, W, 3) light by one photograph, in units of the longest exposure's white."""
        values = self.curves[number].linear(self.views[number].pixels)
        return np.asarray(np.float32(self.factors[number]) * values, np.float32)

    def disagreement(self) -> float:
        """Largest median |log ratio| of light, by what both measure, of neighbours in exposure."""
        order = np.argsort(self.factors, kind="stable").tolist()
        worst = 0.0
        for one, other in zip(order, order[1:], strict=False):
            pair = self.views[one], self.views[other]
            both = np.logical_and(*(view.inside & ~view.near_clipped for view in pair))
            first, second = (
                cv2.GaussianBlur(self.light(k).mean(axis=2), (0, 0), _NOISY)[both]
                for k in (one, other)
            )
            lit = second > self.factors[other] * faintest_value(self.views[other].photo)
            if lit.sum() < _FEWEST_LIT:
                return math.inf
            ratio = np.log(np.maximum(second[lit], 1e-9) / np.maximum(first[lit], 1e-9))
            worst = max(worst, float(np.median(np.abs(ratio))))
        return worst

    def merged(self) -> Photo:
        """One photograph of their radiance, in units of the longest exposure's white."""
        first = self.views[0].photo
        total, weights = np.zeros_like(first.pixels), np.zeros_like(first.pixels)
        noise = np.zeros_like(total)
        longest_first = np.argsort(self.factors, kind="stable").tolist()
        clips, bound = np.zeros(first.clipped.shape, np.bool_), np.zeros_like(total)
        for number in longest_first:
            view, light, weight = self.views[number], self.light(number), self._weight(number)
            if number != longest_first[0]:
                faintest = self.factors[number] * faintest_value(view.photo)
                x, y = self.views[longest_first[0]].highlight
                way = view.highlight[0] - x, view.highlight[1] - y
                flank = (weights > 0.0) & (light > faintest) & ~clips[..., None]
                flank &= dilated(clips, view.glint_reach)[..., None]
                known = np.asarray(total / np.maximum(weights, 1e-30), np.float32)
                follows = _following(light, known, flank, way)
                light = light * follows
                weight = np.asarray(weight / np.square(follows), np.float32)
                light = light * _evening(light, total, weights, faintest, view.glint_reach)
                moved = _moved(light, total, weights, faintest)
                bright = np.maximum(light, known).max(axis=2) > _GLINT
                glint = moved & bright & dilated(clips, view.glint_reach)
                weight = weight * ~(moved & ~glint)[..., None]
                for each in (total, weights, noise):
                    each[glint & view.inside] = 0.0
            clips |= view.inside & view.near_clipped
            bound = np.where(view.inside[..., None], np.maximum(bound, light), bound)
            total += weight * light
            weights += weight
            if view.noise is not None:
                noise += weight * np.float32(self.factors[number]) * view.noise
        measured = weights > 0.0
        weights = np.maximum(weights, np.float32(1e-30))
        clipped = np.asarray(~measured.all(axis=2))
        headroom = max(
            factor * float(curve.linear(np.array(view.photo.headroom)))
            for view, factor, curve in zip(self.views, self.factors, self.curves, strict=True)
        )
        longest = longest_first[0]
        linear = all(not view.photo.tone_mapped for view in self.views)
        return replace(
            first,
            pixels=np.where(measured, total / weights, bound),
            clipped=clipped,
            stored_clipped_share=float(clipped.mean()),
            headroom=headroom,
            noise=noise / weights if all(v.noise is not None for v in self.views) else None,
            radiometric=all(view.photo.radiometric for view in self.views),
            floating=any(view.photo.floating for view in self.views) and linear,
            exposure=self.views[longest].photo.exposure,
            tone=self.views[longest].photo.tone or self.curves[longest],
            notes=(*first.notes, *self._notes()),
        )

    def _notes(self) -> tuple[str, ...]:
        others = []
        for view, factor in zip(self.views[1:], self.factors[1:], strict=True):
            stops = math.log2(factor / self.factors[0])
            how = "darker" if stops > 0.0 else "brighter"
            others.append(f"{view.photo.name} ({abs(stops):.1f} stops {how})")
        own = (f"{v.photo.name}: {note}" for v in self.views[1:] for note in v.photo.notes)
        return (f"{MERGED} {', '.join(others)}.", *own)

    def _weight(self, number: int) -> Picture:
        """(H, W, 3) inverse variance of a photograph's light, faded out towards its clip level and
        below its faintest value, which may be 0 whatever the light.
        """
        view, curve = self.views[number], self.curves[number]
        photo, faintest = view.photo, np.float32(faintest_value(view.photo))
        values = np.maximum(view.pixels, faintest)
        tone, codes = photo.tone or curve, photo.developed(values)
        if view.noise is not None:
            variance = cv2.GaussianBlur(np.square(view.noise), (0, 0), _NOISE_AROUND)
        else:
            variance = _SHOT * codes + np.float32(1e-7)
            if not photo.floating:
                step = 1.0 / (255.0 * srgb_slope(np.minimum(codes, 1.0)))
                variance = variance + np.square(step) / 3.0
        # Of the logarithm of light, by the curve's slope d log x / d log y = 1 / (c (1 - w y)).
        slope = 1.0 / (tone.exponent * np.maximum(1.0 - tone.shoulder * codes, 0.05))
        relative = variance * np.square(slope / codes)
        relative = relative + np.float32(_NEAR_CLIPPED**2) * view.near_clipped[..., None]
        low, high = (share * min(photo.headroom, 1e30) for share in _FADES)
        fade = np.clip((high - values.max(axis=2)) / (high - low), 0.0, 1.0)[..., None]
        fade = fade * np.square(np.maximum(view.pixels / faintest, 0.03).clip(max=1.0))
        light = np.float32(self.factors[number]) * curve.linear(values)
        weight = fade / (relative * np.square(light) + np.float32(1e-12))
        known = view.inside & ~view.clipped
        return np.asarray(np.where(known[..., None], weight, 0.0), np.float32)


def _following(
    light: Picture, known: Picture, flank: NDArray[np.bool_], way: tuple[float, float]
) -> Picture:
    """(H, W, 1) factor from light whose highlight moved by a way (x, y) to that of a longer one.

    Means over rings around the mirror point say how the lobe falls off; its texture stays. The
    exponent of their ratio is regressed on the known light of the flank: 1 on flat material, 0
    where glints stay on slopes steeper than the way.
    """
    grey, rows, columns = light.mean(axis=2), *light.shape[:2]
    if math.hypot(*way) < _LEAST_WAY or not flank.any():
        return np.ones((rows, columns, 1), np.float32)
    y, x = divmod(int(cv2.GaussianBlur(grey, (0, 0), _LOBE * columns).argmax()), columns)

    def rings(x: float, y: float) -> Picture:
        down, across = np.ogrid[-y : rows - y - 0.5, -x : columns - x - 0.5]
        return np.asarray(_RINGS * np.log2(1.0 + np.hypot(down, across) / (_INNERMOST * columns)))

    here, there = rings(x, y), rings(x - way[0], y - way[1])
    ring = np.rint(here).astype(np.int64).ravel()
    counts = np.bincount(ring)
    (many,) = np.nonzero(counts)
    sums, counts = np.bincount(ring, grey.ravel())[many], counts[many]
    for k in range(len(many) - 2, -1, -1):  # few pixels: mostly those of the next ring
        sums[k] += _FEW_OF_RING * sums[k + 1] / counts[k + 1]
        counts[k] += _FEW_OF_RING
    profile = np.log(np.maximum(sums / counts, 1e-6))
    more = np.interp(there, many, profile) - np.interp(here, many, profile)
    seen = flank.all(axis=2)
    off = np.log(np.maximum(known.mean(axis=2)[seen], 1e-6) / grey[seen])
    share = (off @ more[seen]) / max(float(more[seen] @ more[seen]), 1e-9)
    return np.asarray(np.exp(np.clip(share, 0.0, 1.0) * more)[..., None], np.float32)


def _evening(
    light: Picture, total: Picture, weights: Picture, faintest: float, reach: int
) -> Picture:
    """(H, W, 1) smooth factor from light to what longer exposures measure around.

    A highlight moves with the camera. Its flanks, which both measure, say how much light differs
    there and between them. What is near white in either is left out: the longer shows no more.
    """
    known = total / np.maximum(weights, 1e-30)
    dull = np.maximum(light, known).max(axis=2, keepdims=True) < _FADES[0]
    ratio, of = _log_ratio(light, total, weights, dull & (light > faintest), 2.0 * reach)
    return np.asarray(np.exp(-ratio / (of + np.float32(1e-2)))[..., None], np.float32)


def _moved(light: Picture, total: Picture, weights: Picture, faintest: float) -> NDArray[np.bool_]:
    """(H, W) where light above the faintest disagrees with what longer exposures measure."""
    ratio, of = _log_ratio(light, total, weights, light > faintest, _LOCAL)
    return np.asarray((of > 1e-3) & (np.abs(ratio) > _DEVIATES * np.maximum(of, 1e-3)))


def _log_ratio(
    light: Picture, total: Picture, weights: Picture, where: NDArray[np.bool_], deviation: float
) -> tuple[Picture, Picture]:
    """(H, W) local sums of log ratios of light to what longer exposures measure, and of weights."""
    both = (weights > 0.0) & where
    known = np.maximum(total, 1e-6) / np.maximum(weights, 1e-30)
    ratio = np.where(both, np.log(np.maximum(light, 1e-6)) - np.log(np.maximum(known, 1e-6)), 0.0)
    sums, of = (
        cv2.GaussianBlur(np.asarray(each, np.float32).mean(axis=2), (0, 0), deviation)
        for each in (ratio, both)
    )
    return np.asarray(sums, np.float32), np.asarray(of, np.float32)


def fine_bracket(
    paths: Sequence[Path], detail: int, *, fov: float | None = None, white: float | None = None
) -> Bracket | None:
    """The bracket of files that are no RAW, read once, at up to _FINEST; None if they are none.

    With RAW ones, None if photographs of `detail` pixels across can be aligned by themselves.

    Its tone curve is that of single pixels: downsampling averages glints that the curve has
    compressed, and the shoulder would be found too strong (12 materials at half the resolution: w
    off by 0.08, not by 0.02).
    """
    raw = any(file_kind(path) in (FileKind.RAW, FileKind.DNG) for path in paths)
    if raw and detail >= _MERGED:
        return None
    pixels = _DETECTED if raw else _FINEST
    read = partial(load_photo, long_side=pixels, fov=fov, noise=False, white=white)
    return aligned_bracket([read(path) for path in paths], sampled=not raw)


def aligned_bracket(photos: Sequence[Photo], *, sampled: bool = False) -> Bracket | None:
    """The bracket of photographs, aligned to the first; None if they are none.

    Args:
        sampled: of single pixels, on a grid of at most COLUMNS.
    """
    if not 2 <= len(photos) <= MOST:
        return None
    medians = sorted(math.log2(max(float(np.median(p.pixels[::4, ::4])), 1e-9)) for p in photos)
    if any(b - a < _LEAST_DARKER for a, b in zip(medians, medians[1:], strict=False)):
        return None
    homographies = [np.eye(3)]
    for photo in photos[1:]:
        homography = alignment(photos[0], photo)
        if homography is None or way_of_camera(homography, photos[0], photo) > _NEAR:
            return None
        homographies.append(homography)
    views = _views(photos, homographies, sampled=sampled)
    order = sorted(range(len(views)), key=lambda n: -np.median(views[n].pixels.mean(axis=2)))
    factors, curve = {order[0]: 1.0}, None
    for brighter, darker in zip(order, order[1:], strict=False):
        pair = views[brighter], views[darker]
        inside = pair[0].inside & pair[1].inside
        # Not blurred: a blur carries clipped sparkles into what is not clipped.
        pixels = pair[0].pixels[inside], pair[1].pixels[inside]
        ratio = ratio_of_exposures(pair[0].photo, pair[1].photo, pixels, curve)
        if ratio is None or ratio.residual > _SAME_LIGHT:
            return None
        if not LEAST_STOPS < -math.log2(ratio.darker) < MOST_STOPS:
            return None
        factors[darker] = factors[brighter] / ratio.darker
        curve = curve or ratio.curve
    bracket = Bracket(
        views,
        tuple(factors[number] for number in range(len(views))),
        tuple(curve or ToneCurve() if p.tone_mapped else ToneCurve() for p in photos),
    )
    return bracket if bracket.disagreement() < _SAME_PIXELS else None


def _views(
    photos: Sequence[Photo], homographies: Sequence[Matrix], *, sampled: bool
) -> tuple[_Aligned, ...]:
    """Photographs on the pixels of the first; arguments as of aligned_bracket."""
    first, (rows, columns) = photos[0], photos[0].pixels.shape[:2]
    if sampled:
        shape = round(rows * min(1.0, COLUMNS / columns)), min(columns, COLUMNS)
        views = [_resampled(first, np.eye(3), shape, cv2.INTER_NEAREST)]
    else:
        shape, near = (rows, columns), _spread_clipping(first) > 0.05
        inside = np.ones(shape, np.bool_)
        views = [_Aligned(first, first.pixels, inside, first.clipped, near, first.noise)]
    how = cv2.INTER_NEAREST if sampled else cv2.INTER_CUBIC
    for photo, homography in zip(photos[1:], homographies[1:], strict=True):
        way = way_of_camera(homography, first, photo)
        highlight = (shape[1] * step for step in way_of_highlight(homography, first, photo))
        view = _resampled(photo, homography, shape, how)
        known = replace(view, way=way, homography=homography, highlight=tuple(highlight))
        views.append(known)
    return tuple(views)


def merge_bracket(photos: Sequence[Photo]) -> Photo:
    """One photograph of a bracket, on the pixels of the first.

    Raises:
        MatcapError: they are no bracket at this resolution.
    """
    bracket = aligned_bracket(photos)
    if bracket is None:
        names = ", ".join(photo.name for photo in photos[1:])
        raise MatcapError.at(
            photos[0].name,
            f"is not of the same place and light as {names}",
            "give them with --together, or each on its own",
        )
    return bracket.merged()


def _resampled(photo: Photo, homography: Matrix, shape: tuple[int, ...], how: int) -> _Aligned:
    """A photograph on the pixels of another of shape (H, W), interpolated as OpenCV names it."""
    rows, columns = shape
    warp = np.linalg.inv(pixel_units(photo.pixels.shape[1])) @ homography @ pixel_units(columns)

    def seen(picture: Picture, how: int, border: int = cv2.BORDER_REPLICATE) -> Picture:
        flags = how | cv2.WARP_INVERSE_MAP
        return np.asarray(
            cv2.warpPerspective(picture, warp, (columns, rows), flags=flags, borderMode=border),
            np.float32,
        )

    pixels = np.maximum(seen(photo.pixels, how), 0.0)
    clipped = seen(photo.clipped.astype(np.float32), cv2.INTER_LINEAR) > 0.01
    near_clipped = clipped | (seen(_spread_clipping(photo), cv2.INTER_LINEAR) > 0.05)
    inside = seen(np.ones(photo.clipped.shape, np.float32), cv2.INTER_LINEAR, cv2.BORDER_CONSTANT)
    noise = None if photo.noise is None else seen(photo.noise, cv2.INTER_CUBIC)
    return _Aligned(photo, pixels, inside > 0.99, clipped, near_clipped, noise)


def _spread_clipping(photo: Photo) -> Picture:
    """(H, W) share of clipped pixels in the blur around each."""
    clipped = photo.clipped.astype(np.float32)
    return np.asarray(cv2.GaussianBlur(clipped, (0, 0), _SPREAD), np.float32)
