"""Stage inpaint: maps that the highlight hides are copied from other places of the exemplar.

Near the mirror point the highlight hides albedo, and all maps where it is clipped. A sample is
stationary, so maps are copied there from visible places, in three steps:

1. remaining_highlight: texels whose albedo still has the highlight lose their confidence;
2. transport: blocks with too little confidence get the maps of others [aittala2015];
3. composed: all maps are joined to their surroundings without steps [perez2003].

Finer detail, which is added to the maps later, is copied from the same places (Copies).
"""

from __future__ import annotations

import ctypes
import itertools
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import Reflectance
from matcap.brdf.maps import DIFFUSE, HEIGHT, ROUGHNESS, SPECULAR
from matcap.capture.exemplar.predict import map_set_of
from matcap.capture.rectified import Observation, PhotographLight
from matcap.example.candidates import planes_of
from matcap.example.exemplar import Exemplar
from matcap.example.lattice import PhasedLattice, measure_lattice
from matcap.example.library import address, loops
from matcap.example.placement import texture_trend
from matcap.files.threads import at_once, one_thread
from matcap.flash.highlight import remaining_highlight
from matcap.flash.least_squares import conjugate_gradients
from matcap.flash.light import DARKEST
from matcap.photo.left_out import dilated
from matcap.statistics.lattice import Wave
from matcap.statistics.streaks import streaks

# Inpainting under the highlight; docs/notes/capture.md. NSD is the normalised style distance.
_TRIED = 1000  # random candidate blocks per place
_RENDERED = 40  # as many of those that match the overlap best, and of the others, are rendered
_CONTRAST = 0.25  # w of the equation in transport
_BLOCK = 48  # side of a block, texels: larger than the texture's features, small enough to match
_OVERLAP = _BLOCK // 4  # overlap of neighbouring blocks, texels
# Least confidence of albedo in donors, over that of well seen texels. Larger values inpaint
# visible texels: at 0.93 wood loses 0.4 NSD.
_LEAST_CONFIDENCE = 0.75
_WELL_SEEN = 0.75  # quantile of confidence that defines well seen
_MOST_HIDDEN = 0.2  # largest share of the picture to inpaint, more than any flash hides
_WHOLE_DONOR = 0.95  # least confident share of a donor block
# A texel whose log albedo is this many times the median distance from the median is a mark, unless
# more than _MARKED of the picture are: dust, a stain, what lies around the sample.
_OUTSTANDING, _MARKED = 7.0, 0.03
_GRAIN = 8  # texels of marks in a block that nobody sees a second time
_WANTED_SHARE = 0.25  # least hidden share of a block that is replaced
# Mismatch of a block that has been copied before: the eye finds it next to itself.
_REUSED = 0.3
# Weight of the mismatch with the photograph against the overlap's mismatch.
_PHOTOGRAPH_WEIGHT = 0.7
# Weight of the mean squared departure of a donor from its place by a trend of texture, visible
# changes; squares that the trend is measured in, texels.
_UNLIKE, _SQUARE = 0.2, 16
# A place keeps its maps if its energy of log radiance is above _MOST_ENERGY times the candidates'
# median, a share above _VISIBLE_SHARE is visible, and its maps render _OWN_ENERGY of it: a scratch,
# or bare metal that only the highlight shows. Maps with too flat relief do not: in a highlight
# measured above white granite's have 0.2 of it, leather's 0.4 to 0.67, a scratch's 0.77 and more.
_MOST_ENERGY, _VISIBLE_SHARE, _OWN_ENERGY = 2.0, 0.5, 0.7
_SPREAD = 4  # texels over which a hidden texel's light spreads to its neighbours
_THINNED = 4  # subsampling, texels, of rendered candidates
_FARTHEST = 4.0  # upper limit of a squared standardised difference in the overlap
_PLAIN = 0.5  # variance to which that of both sides of an overlap is added
_SEAM_REACH = _BLOCK / 2.0  # texels over which the two sides of a seam converge
_TOLERANCE = 1e-3  # norm of the residual over that at the start, at which the iterations end

Floats = NDArray[np.float32]
TexelMask = NDArray[np.bool_]
BlockPlaces = NDArray[np.int64]


@dataclass(frozen=True)
class Copies:
    """Texels that are copied from others."""

    source: BlockPlaces
    """(2, H, W) row and column that each texel is copied from; its own where it is not."""
    copied: TexelMask
    """(H, W)."""

    def read(self, planes: Floats) -> Floats:
        """Planes (C, h, w) of the same rectangle on another grid, copied likewise."""
        height, width = planes.shape[1:]

        def enlarged(plane: NDArray[Any]) -> Floats:
            thin = plane.astype(np.float32)
            wide = cv2.resize(thin, (width, height), interpolation=cv2.INTER_NEAREST)
            return np.asarray(wide, np.float32)

        rows, columns = np.nonzero(enlarged(self.copied))
        down, right = self.source - np.indices(self.copied.shape)
        by = height / down.shape[0], width / right.shape[1]
        from_rows = rows + np.rint(by[0] * enlarged(down)[rows, columns]).astype(np.int64)
        from_columns = columns + np.rint(by[1] * enlarged(right)[rows, columns]).astype(np.int64)
        copied = planes.copy()
        source = from_rows.clip(0, height - 1), from_columns.clip(0, width - 1)
        copied[:, rows, columns] = planes[:, *source]
        return copied


def inpainted(
    exemplar: Exemplar, observed: Observation, waves: tuple[Wave, ...] = ()
) -> tuple[Exemplar, Copies | None]:
    """Inpaint an exemplar where specular light hides its maps, or is left in its albedo.

    Args:
        exemplar: estimated maps and their confidence, which also falls to 0 in the highlight's
            remainder.
        waves: frequency vectors of its lattice, cycles per texel.

    Returns:
        The exemplar, and what it is copied from; None if nothing is.
    """
    plane = observed.plane
    distance = (observed.from_mirror_point / plane.texel_size).numpy()
    spot = remaining_highlight(exemplar.diffuse, observed.within.numpy(), distance)
    exemplar = replace(exemplar, confidence=exemplar.confidence * ~spot)
    photographed = plane.linear, plane.valid, plane.kept
    return transport(exemplar, *photographed, observed.light, waves)


@one_thread()
@torch.no_grad()
def transport(
    exemplar: Exemplar,
    linear: Tensor,
    valid: Tensor,
    kept: Tensor,
    light: PhotographLight,
    waves: tuple[Wave, ...] = (),
) -> tuple[Exemplar, Copies | None]:
    """Copy blocks of maps to where specular light hides them (reflectance transport).

    A block minimises its mismatch with neighbours in the overlap plus that of its rendering in
    place with the photograph (texture transfer [efros2001]),

        1 - correlation(a, b) + w |log(|a|^2 / |b|^2)|,

    where a and b are log radiance of the block and of the photograph, less their quadratic trends
    over the block, which are errors of the fitted highlight, and w is _CONTRAST.

    Args:
        exemplar: estimated maps; confidence is not changed.
        linear: (3, H, W) the photograph on its plane.
        valid: (H, W) bool, visible and not clipped.
        kept: (H, W) bool, the material; masked texels that it surrounds are inpainted, too.
        light: the photograph's, at every texel.
        waves: frequency vectors of its lattice, with which copies are in phase.

    Returns:
        The exemplar, and what it is copied from; the same object and None if no block is hidden by
        _WANTED_SHARE, or none can be a donor.
    """
    confidence, known = exemplar.confidence[0], kept.numpy()
    relative = confidence / max(float(np.quantile(confidence[known], _WELL_SEEN)), 1e-6)
    most = float(np.quantile(relative[known], _MOST_HIDDEN)) + 1e-6
    hidden = dilated(relative < min(_LEAST_CONFIDENCE, most), _SPREAD)
    # Of a black sample more than the hidden part is too dark to show relief.
    seen = relative >= min(_LEAST_CONFIDENCE, float(np.median(relative[known])))
    donors = _donors(seen & ~hidden & known, exemplar.diffuse)
    # Texels outside of a crop are not inpainted: they have none known in their row, or column.
    rows, columns = np.asarray(known.any(axis=1)), np.asarray(known.any(axis=0))
    hidden = (hidden & known) | (rows[:, None] & columns & ~known)
    if not len(donors):
        return exemplar, None
    places = [p for p in _grid(hidden.shape) if hidden[_block(p)].mean() > _WANTED_SHARE]
    if not places:
        return exemplar, None
    (features, fine), trend = at_once(
        partial(_features, exemplar, ~hidden), partial(_trend, exemplar, ~hidden)
    )
    # From visible surroundings inwards, so that patterns continue.
    places.sort(key=lambda p: -float(relative[_block(p)].mean()))
    valid = valid & torch.from_numpy(confidence > 0.0)
    photograph = _Photograph(exemplar, linear, valid, light)
    choice = _Donors(donors, ~hidden, trend, _lattice(features, relative, waves))
    chosen = _choose(places, choice, features, photograph)
    del photograph, choice  # 80 MB of 1024 texels across, which composing has other use for
    source, copied = _sources(chosen, hidden)
    return _filled(exemplar, fine, source, copied), Copies(source, copied)


def _filled(exemplar: Exemplar, fine: Floats, source: BlockPlaces, copied: TexelMask) -> Exemplar:
    """The exemplar with what is copied from its sources; of height only what is `fine` (H, W)."""
    maps, texel = exemplar.stacked().astype(np.float32), exemplar.texel_size
    slow = maps[HEIGHT] - fine
    # Blocks are blended in logarithms of albedo and F0, and heights in texels.
    for kind in (DIFFUSE, SPECULAR):
        maps[kind] = np.log(maps[kind].clip(DARKEST))
    maps[HEIGHT] = fine / texel
    blended = composed(maps, source, copied, _SEAM_REACH)
    return replace(
        exemplar,
        diffuse=np.where(copied, np.exp(blended[DIFFUSE]), exemplar.diffuse).clip(0.0, 1.0),
        specular=np.where(copied, np.exp(blended[SPECULAR]), exemplar.specular).clip(0.0, 1.0),
        roughness=np.where(copied, blended[ROUGHNESS], exemplar.roughness).clip(0.0, 1.0),
        height=np.where(copied, blended[HEIGHT] * texel + slow, exemplar.height),
    )


@dataclass(frozen=True)
class _Match:
    """Match of N candidate blocks, rendered at a place, to the photograph there."""

    mismatch: Floats
    """(N,) mismatch of log radiance (transport); 0 without valid texels."""
    energy_ratio: float
    """Energy of the photographed log radiance over the median of random candidates."""
    own: float
    """Energy that the place's own maps render, over that photographed."""
    share: float
    """Share of the place that is visible and not clipped."""

    @property
    def is_distinct(self) -> bool:
        """Whether photograph and maps have far more contrast than the candidates: a scratch."""
        more = self.energy_ratio > _MOST_ENERGY and self.own > _OWN_ENERGY
        return more and self.share > _VISIBLE_SHARE


class _Photograph:
    """The photograph and its light, for comparing rendered blocks with it."""

    def __init__(
        self, exemplar: Exemplar, linear: Tensor, valid: Tensor, light: PhotographLight
    ) -> None:
        self._log = linear.clamp_min(DARKEST).log()
        # Log radiance is steep where it begins to clip.
        self._valid = torch.from_numpy(~dilated(~valid.numpy(), _SPREAD))
        self._light = light
        maps = map_set_of(exemplar)
        planes = torch.cat([maps.diffuse, maps.specular, maps.roughness, maps.normal])
        self._maps = planes.movedim(0, -1).numpy().copy()  # a texel's numbers lie together
        # Log radiance of the mean material, subtracted from both sides of a comparison.
        even, _ = _parts(planes.mean((1, 2), keepdim=True).expand_as(planes))
        upright = torch.zeros_like(maps.normal)
        upright[2] = 1.0
        self._even = light.flash.onto(upright).log_radiance(even)[0]

    def match(self, place: tuple[int, int], blocks: BlockPlaces) -> _Match:
        """Render blocks at a place and compare them with the photograph there."""
        blocks = np.concatenate([blocks, [place]])
        here = tuple(slice(start, start + _BLOCK, _THINNED) for start in place)
        light = self._light.cut(*here)
        parts = (partial(self._rendered, some, light) for some in np.array_split(blocks, 2))
        log = torch.cat(at_once(*parts))
        seen = self._valid[here].to(log)
        share = float(self._valid[_block(place)].float().mean())
        if not seen.any():
            return _Match(np.zeros(len(blocks) - 1, np.float32), 0.0, 0.0, share)
        even, shown = (x[(slice(None), *here)][None] for x in (self._even, self._log))
        a, b = _detrended(torch.cat([log, shown]) - even, seen).split([len(log), 1])
        lit, photographed = (x.square().sum((1, 2, 3)) for x in (a, b))
        mismatch = 1.0 - (a * b).sum((1, 2, 3)) / ((lit * photographed).sqrt() + 1e-6)
        ratio = (lit + 1e-6) / (photographed + 1e-6)
        mismatch += _CONTRAST * ratio.log().abs().clamp_max(2.0)
        energy_ratio = float(photographed / (lit[len(lit) // 2 : -1].median() + 1e-6))
        own = float(lit[-1] / (photographed + 1e-6))
        return _Match(np.asarray(mismatch[:-1], np.float32), energy_ratio, own, share)

    def _rendered(self, blocks: BlockPlaces, light: PhotographLight) -> Tensor:
        """(N, 3, h, w) log radiance of blocks (N, 2) in the light of a place, thinned."""
        inner = np.arange(0, _BLOCK, _THINNED)
        rows, columns = blocks[:, 0, None, None] + inner[:, None], blocks[:, 1, None, None] + inner
        reflectance, normal = _parts(torch.from_numpy(self._maps[rows, columns]).movedim(-1, 1))
        return light.flash.onto(normal).log_radiance(reflectance)[0]


def _parts(planes: Tensor) -> tuple[Reflectance, Tensor]:
    """Split planes (..., 8, H, W), or 10 if F0 has a colour, into reflectance and normals."""
    *reflectance, normal = planes.split([3, planes.shape[-3] - 7, 1, 3], dim=-3)
    return Reflectance(*reflectance), normal


def _detrended(log: Tensor, seen: Tensor) -> Tensor:
    """Log radiance (..., h, w) less its quadratic trend over visible texels (h, w); 0 elsewhere."""
    y, x = (torch.linspace(-1.0, 1.0, side).to(log) for side in seen.shape)
    y, x = (v.flatten() for v in torch.meshgrid(y, x, indexing="ij"))
    smooth = torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y]) * seen.flatten()
    basis = torch.linalg.svd(smooth, full_matrices=False).Vh
    flat = log.flatten(-2) * seen.flatten()
    return (flat - (flat @ basis.T) @ basis).unflatten(-1, seen.shape)


@dataclass(frozen=True)
class _Donors:
    """Blocks that may be copied."""

    corners: BlockPlaces
    """(N, 2)"""
    known: TexelMask
    """(H, W) texels that are not hidden."""
    trend: Floats
    """Of texture (_trend)."""
    lattice: PhasedLattice | None
    """Of a regular texture."""

    @cached_property
    def _allowed(self) -> TexelMask:
        allowed = np.zeros(self.known.shape, np.bool_)
        allowed[self.corners[:, 0], self.corners[:, 1]] = True
        return allowed

    def candidates(
        self,
        place: tuple[int, int],
        chosen: dict[tuple[int, int], tuple[int, int]],
        rng: np.random.Generator,
    ) -> BlockPlaces:
        """(N, 2) _TRIED random blocks, of a lattice in its phase, and what continues neighbours."""
        blocks = self.corners[rng.integers(len(self.corners), size=_TRIED)]
        if self.lattice is not None:
            y, x = np.array(place)[:, None] + _BLOCK // 2
            rows, columns = (blocks + _BLOCK // 2).T
            columns, rows = self.lattice.in_phase(self.lattice.phases(x, y), columns, rows)
            moved = self._usable(np.stack([rows, columns], axis=1) - _BLOCK // 2)
            blocks = moved if len(moved) >= _RENDERED else blocks
        follow = self._usable(np.array(_continued(place, chosen), np.int64).reshape(-1, 2))
        return np.concatenate([blocks, follow])

    def _usable(self, blocks: BlockPlaces) -> BlockPlaces:
        inside = (blocks >= 0).all(axis=1) & (blocks < self._allowed.shape).all(axis=1)
        blocks = blocks[inside]
        return blocks[self._allowed[blocks[:, 0], blocks[:, 1]]]


def _lattice(features: Floats, seen: Floats, waves: tuple[Wave, ...]) -> PhasedLattice | None:
    """The lattice of features, which count by how well they are seen."""
    weight = seen.clip(0.0, 1.0)
    means = (features * weight).mean(axis=(1, 2)) / max(float(weight.mean()), 1e-6)
    return measure_lattice((features - means[:, None, None]) * weight, waves)


def _choose(
    places: list[tuple[int, int]], donors: _Donors, features: Floats, photograph: _Photograph
) -> dict[tuple[int, int], tuple[int, int]]:
    """Corner of the donor block of every place; distinct places keep their maps, without entry."""
    rng = np.random.default_rng(0)
    known, donor = donors.known.copy(), np.zeros((*donors.known.shape, 4), np.float32)
    donor[..., :3] = np.moveaxis(features, 0, -1)  # a texel's numbers lie together
    seen = donor.copy()
    copied = np.zeros_like(known)
    chosen: dict[tuple[int, int], tuple[int, int]] = {}
    for place in places:
        here, blocks = _block(place), donors.candidates(place, chosen, rng)

        def misfit(some: BlockPlaces, place: tuple[int, int] = place) -> Floats:
            mismatch = _discontinuity(place, some, donor, seen, known)
            mismatch += _REUSED * _shown_before(some, ~known[_block(place)], copied)
            mismatch += _UNLIKE * _departure(donors.trend, place, some)
            return mismatch

        parts = (partial(misfit, some) for some in np.array_split(blocks, 2))
        mismatch = np.concatenate(at_once(*parts))
        nearest = np.argsort(mismatch, kind="stable")[:_RENDERED]
        nearest = np.concatenate([nearest, np.arange(min(_RENDERED, len(blocks)))])
        blocks, mismatch = blocks[nearest], mismatch[nearest]
        shown = photograph.match(place, blocks)
        best = int((mismatch + _PHOTOGRAPH_WEIGHT * shown.share * shown.mismatch).argmin())
        source = place if shown.is_distinct else (int(blocks[best][0]), int(blocks[best][1]))
        if not shown.is_distinct:
            chosen[place] = source
        there = _block(source)
        copied[there] |= ~known[here]
        seen[here] = np.where(known[here][..., None], seen[here], donor[there])
        known[here] = True
    return chosen


def _trend(exemplar: Exemplar, visible: TexelMask) -> Floats:
    """(6, rows, columns) trend of texture in squares of _SQUARE texels (texture_trend).

    Relief is combed along the flash, and shown the more the farther from it: where a donor departs
    from its place by that, it is a patch of another cloth.
    """
    rows, columns = (-(-side // _SQUARE) for side in visible.shape)
    seen = cv2.resize(visible.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
    # Local averages near what is hidden have some of it.
    whole = cv2.erode((seen > 1.0 - 1e-3).astype(np.uint8), np.ones((3, 3)), borderValue=1) > 0
    return np.asarray(texture_trend(planes_of(exemplar), np.asarray(whole)), np.float32)


def _departure(trend: Floats, place: tuple[int, int], blocks: BlockPlaces) -> Floats:
    """(N,) mean squared departure of blocks from a place by a trend."""
    y, x = ((np.array(place) + _BLOCK // 2) // _SQUARE).tolist()
    rows, columns = ((blocks + _BLOCK // 2) // _SQUARE).T
    return np.asarray(np.square(trend[:, rows, columns] - trend[:, y, x, None]).mean(0), np.float32)


def _shown_before(blocks: BlockPlaces, new: TexelMask, copied: TexelMask) -> Floats:
    """(N,) share of the texels that blocks would add, `new`, that have been copied before."""
    rows, columns = (_THINNED * each for each in np.nonzero(new[::_THINNED, ::_THINNED]))
    if not rows.size:
        return np.zeros(len(blocks), np.float32)
    sources = blocks[:, :1] + rows, blocks[:, 1:] + columns
    return np.asarray(copied[sources].mean(axis=1), np.float32)


def _continued(
    place: tuple[int, int], chosen: dict[tuple[int, int], tuple[int, int]]
) -> list[tuple[int, int]]:
    """Corners of the blocks that continue the donors of the neighbouring places."""
    steps = (_OVERLAP - _BLOCK, 0, _BLOCK - _OVERLAP)
    return [
        (chosen[there][0] - dy, chosen[there][1] - dx)
        for dy, dx in itertools.product(steps, steps)
        if (there := (place[0] + dy, place[1] + dx)) in chosen
    ]


def _discontinuity(
    place: tuple[int, int], blocks: BlockPlaces, donor: Floats, seen: Floats, known: TexelMask
) -> Floats:
    """(N,) mean squared difference of blocks to known texels of a place, over variances of both.

    Without these a plain block fits anything better than another part of an irregular texture.
    Donor and seen are (H, W, 4): features, then zeros.
    """
    here = tuple(slice(start, start + _BLOCK, 2) for start in place)
    rows, columns = 2 * np.array(np.nonzero(known[here]))
    sums, most = np.zeros((2, len(blocks)), np.float32), ctypes.c_float(_FARTHEST)
    if not rows.size:
        return sums[0]
    shown, across = seen[place[0] + rows, place[1] + columns], donor.shape[1]
    texels, corners = rows * across + columns, blocks @ np.array([across, 1])
    sizes = ctypes.c_int32(len(texels)), ctypes.c_int32(len(corners))
    arrays = (address(each) for each in (donor, shown, texels, corners))
    loops().matcap_discontinuity(*arrays, *sizes, most, address(sums))
    # Sums over the features, which are three.
    return np.asarray(sums[0] / (sums[1] + shown.var(axis=0).sum() + 3.0 * _PLAIN), np.float32)


def _sources(
    chosen: dict[tuple[int, int], tuple[int, int]], hidden: TexelMask
) -> tuple[BlockPlaces, TexelMask]:
    """(2, H, W) source row and column of each texel, and (H, W) bool, which are copied.

    A texel is copied from the block whose centre is nearest.
    """
    texels, nearest = np.indices(hidden.shape), np.full(hidden.shape, np.inf)
    source = texels.copy()
    distance = np.abs(np.indices((_BLOCK, _BLOCK)) - 0.5 * (_BLOCK - 1)).max(axis=0)
    for place, donor in chosen.items():
        here = _block(place)
        own = hidden[here] & (distance < nearest[here])
        moved = np.array(donor)[:, None, None] - np.array(place)[:, None, None]
        source[:, *here] = np.where(own, texels[:, *here] + moved, source[:, *here])
        nearest[here] = np.where(own, distance, nearest[here])
    return source, np.isfinite(nearest)


def _features(exemplar: Exemplar, known: TexelMask) -> tuple[Floats, Floats]:
    """(3, H, W) channel mean of log albedo, and slopes (x, down), each over its deviation, of
    albedo over known texels; (H, W) height high-passed, as low frequencies are not copied.
    """
    height = exemplar.height[0] / exemplar.texel_size
    fine = height - cv2.GaussianBlur(height, (0, 0), _BLOCK / 1.5)
    down, across = np.gradient(fine)
    lightness = np.log(exemplar.diffuse.clip(1e-3)).mean(0)
    steep = np.sqrt(np.mean(np.square(down) + np.square(across))) + 1e-6
    lightness /= lightness[known].std() + 1e-3
    features = np.stack([lightness, across / steep, down / steep])
    return features.astype(np.float32), fine * exemplar.texel_size


def _marks(albedo: Floats, visible: TexelMask) -> TexelMask:
    """(H, W) bool: visible texels whose albedo, alone or along a line, is like hardly any other's.

    Lines are compared on half of the rows and columns.
    """
    log = np.stack([cv2.GaussianBlur(np.log(plane.clip(1e-3)), (0, 0), 1.0) for plane in albedo])
    deviation = np.abs(log - np.median(log[:, visible], axis=1)[:, None, None]).max(axis=0)
    deviation /= max(float(np.median(deviation[visible])), 1e-6)
    size = visible.shape[1] // 2, visible.shape[0] // 2
    thin = cv2.resize(log.mean(axis=0), size, interpolation=cv2.INTER_AREA)
    seen = cv2.resize(visible.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    lines = cv2.resize(streaks(thin, np.asarray(seen)), visible.shape[::-1])
    marks = np.zeros_like(visible)
    for each in (deviation, lines):
        marks |= each > max(_OUTSTANDING, float(np.quantile(each[visible], 1.0 - _MARKED)))
    return np.asarray(visible & marks)


def _donors(visible: TexelMask, albedo: Floats) -> BlockPlaces:
    """(N, 2) corners of blocks that are visible nearly everywhere, with no more marks than usual.

    The eye finds a mark that is copied; a texture that has marks in most blocks keeps them.
    """
    if min(visible.shape) <= _BLOCK:
        return np.zeros((0, 2), np.int64)
    usable = _counts(visible) >= _WHOLE_DONOR * _BLOCK**2
    if usable.any():
        marked = _counts(_marks(albedo, visible))
        usable &= marked <= max(_GRAIN, 2.0 * np.median(marked[usable]))
    return np.argwhere(usable)


def _counts(texels: TexelMask) -> NDArray[np.int64]:
    """(H - _BLOCK + 1, W - _BLOCK + 1) number of texels in the block at each corner."""
    sums, n = cv2.integral(texels.astype(np.uint8)).astype(np.int64), _BLOCK
    return np.asarray(sums[n:, n:] - sums[:-n, n:] - sums[n:, :-n] + sums[:-n, :-n])


def _grid(shape: tuple[int, ...]) -> list[tuple[int, int]]:
    """Corners of overlapping blocks that cover a plane (H, W)."""
    ends = [side - _BLOCK for side in shape]
    rows, columns = ([*range(0, end, _BLOCK - _OVERLAP), end] for end in ends)
    return [(row, column) for row in rows for column in columns]


def _block(corner: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of the block at a corner."""
    return slice(corner[0], corner[0] + _BLOCK), slice(corner[1], corner[1] + _BLOCK)


def composed(maps: Floats, source: BlockPlaces, free: TexelMask, reach: float) -> Floats:
    """Maps copied from their sources without steps at seams: gradient-domain composition.

    Texel p shows v(p) = m(s(p)), with s(p) = p where the maps are kept. The result u minimises,
    over the texels that are not kept,

        sum_pq (u(q) - u(p) - g(p, q))^2 + sum_p (u(p) - v(p))^2 / reach^2,

    over pairs of neighbours p, q. g(p, q) is the mean of m(s(p) + q - p) - m(s(p)) and
    m(s(q)) - m(s(q) + p - q), over those whose texels are kept ones. Within a block it is the
    gradient of the maps; at a seam it has no step.

    Args:
        maps: (C, H, W) m.
        source: (2, H, W) row and column of s(p); the texel itself where it is not free.
        free: (H, W) texels that are not kept.
        reach: texels over which the two sides of a seam converge.

    Returns:
        (C, H, W) u; m where not free.
    """
    varying = np.ptp(maps, axis=(1, 2)) > 0.0  # a class's F0 is constant
    if not (free.any() and varying.any()):
        return maps
    if not varying.all():
        whole = maps.copy()
        whole[varying] = composed(maps[varying], source, free, reach)
        return whole
    rows, columns = (np.flatnonzero(free.any(axis=axis)) for axis in (1, 0))
    box = tuple(
        slice(max(0, line[0] - 1), min(side, line[-1] + 2))
        for line, side in zip((rows, columns), free.shape, strict=True)
    )
    inside, here = free[box], source[:, *box]
    result = maps.copy()
    copied = maps[:, here[0], here[1]]
    each = zip(maps, copied, strict=True)
    wanted = np.stack(at_once(*(partial(_mismatches, *one, here, free, inside) for one in each)))
    result[:, *box][:, inside] = copied[:, inside] + _solved(wanted, inside, reach)
    return result


def _mismatches(
    plane: Floats, copied: Floats, here: BlockPlaces, free: TexelMask, inside: TexelMask
) -> NDArray[np.float64]:
    """(N,) sums over neighbours of how far gradients of `copied`, a map (H, W) at places `here`,
    are from the wanted ones, at the N texels `inside` (h, w) that are free.
    """
    exact = copied.astype(np.float64)
    wanted = np.zeros_like(exact)
    for axis in (0, 1):
        # All but the last, and all but the first line along the axis.
        first, last = ((slice(None),) * axis + (part,) for part in (slice(-1), slice(1, None)))
        step = np.array([[[1 - axis]], [[axis]]])
        before, after = exact[first], exact[last]
        ahead, has_ahead = _at(plane, here[:, *first] + step, free)
        behind, has_behind = _at(plane, here[:, *last] - step, free)
        drawn = has_ahead * (ahead - before) + has_behind * (after - behind)
        known = has_ahead + has_behind
        mismatch = np.where(known > 0.0, after - before - drawn / np.maximum(known, 1.0), 0.0)
        wanted[first] += mismatch
        wanted[last] -= mismatch
    return wanted[inside]


def _solved(right: NDArray[np.float64], free: TexelMask, reach: float) -> Floats:
    """Solution c of (L + reach^-2) c = right, 0 where not free; L is the graph Laplacian.

    Right and c are (C, N), of the N free texels.
    """
    neighbours, degree = _free_neighbours(free)
    diagonal, known = degree + np.float32(reach**-2), np.ascontiguousarray(right.T, np.float32)
    image, sizes = np.empty_like(known), [ctypes.c_int32(side) for side in known.shape]
    graph = address(neighbours), address(diagonal)

    def product(values: Floats) -> Floats:
        loops().matcap_laplacian(address(values), *graph, *sizes, address(image))
        return image

    # In exact arithmetic as many iterations as unknowns suffice.
    return conjugate_gradients(product, known, len(known), tolerance=_TOLERANCE).T


def _free_neighbours(free: TexelMask) -> tuple[NDArray[np.int64], Floats]:
    """Of N free texels, the four neighbours' numbers (N, 4), and the number of neighbours (N,).

    Texels that are not free have the number N.
    """
    number = np.full((free.shape[0] + 2, free.shape[1] + 2), free.sum(), np.int64)
    number[1:-1, 1:-1][free] = np.arange(free.sum())
    in_box = np.pad(np.ones(free.shape, np.float32), 1)
    within, before, after = slice(1, -1), slice(None, -2), slice(2, None)
    sides = ((before, within), (after, within), (within, before), (within, after))
    degree = np.stack([in_box[side][free] for side in sides], axis=1).sum(1)
    return np.stack([number[side][free] for side in sides], axis=1), degree


def _at(plane: Floats, places: BlockPlaces, free: TexelMask) -> tuple[Floats, Floats]:
    """(h, w) a map at places (2, h, w), and 1 where those are kept texels, else 0."""
    rows, columns = (np.clip(p, 0, side - 1) for p, side in zip(places, free.shape, strict=True))
    kept = (rows == places[0]) & (columns == places[1]) & ~free[rows, columns]
    return plane[rows, columns], kept.astype(np.float32)
