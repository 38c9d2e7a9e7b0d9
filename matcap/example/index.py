"""Index of an exemplar: grids of synthesis levels, tables by level, candidates and penalties."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.example.candidates import (
    COST_BITS,
    DIMENSIONS,
    MOST_ASPECT,
    PLANES,
    SLOPES,
    TAPS,
    Appearance,
    Basis,
    Candidates,
    FeatureMap,
    Frame,
    PatchSizes,
    Scale,
    choose_basis,
    choose_scale,
    features_of,
    find_candidates,
    frame_of,
    grain_aspect,
    grid_bits,
    grids_of,
    level_count,
    planes_of,
    project,
    similar_bits,
    step_of,
)
from matcap.example.exemplar import Exemplar, pack, unpack
from matcap.example.lattice import (
    GRID,
    Frequency,
    PhasedLattice,
    Phases,
    measure_lattice,
    with_least_borders,
)
from matcap.example.placement import RULE, Placement, trend_penalty
from matcap.files.settings import bounded
from matcap.files.threads import at_once

# Index of an exemplar: PCA bases, k-coherence candidates and penalties, computed once at capture.
#
# What follows from these by exact arithmetic is not stored but computed again (index.py);
# appearance vectors alone would take 30 megabytes.
#
# Places of low confidence, and those that stand out, such as stains, have penalties: patches are
# not placed there, and seams avoid them.

# Candidates and penalties of an exemplar; docs/notes/field.md.
_NEAREST_STEPS = 4  # least distance between a place and its candidate, grid steps
_LEAST_TEXELS = 8  # likewise, texels
_FINENESS = 16  # least number of places along the shorter side of a lattice's patch
# Difference from the most similar place over the median from which on a place stands out, and the
# largest share of such places: others belong to the material.
_OUTSTANDING, _SMALL = 7.0, 0.03
# Stains: level of the features that show them, standard deviation of the mean around, texels; their
# departure from it, in deviations (1.48 medians), everywhere and at most; least and largest extent,
# texels; least area, squared texels; largest share of all, as more belong to the material.
_STAINED, _AROUND, _DEPARTS, _PEAK = 3, 32, 2.0, 3.0
_EXTENT, _AREA, _MOST_STAINED = (24, 128), 400, 0.05
_ALIKE = 64.0  # squared difference of appearance that is not visible: one feature by two of UNIT
_LEAST_TRUST = 0.02  # added to a map's confidence before the logarithm
_TRUSTED = 0.8  # quantile of the confidence that places are compared with
_SLACK = 0.05  # confidence below that quantile without a penalty
_DOUBTED = 0.35  # confidence below that quantile at which the penalty is largest
# Least share of places without a penalty. More uses places of wrong maps, less has too few
# places to choose from.
_FREE = 0.5

_MOST, _MARK = 255, 254  # penalties of what is not known, and of what stands out
_KNOWN = 30  # penalty below which a place is compared with others


@dataclass(frozen=True)
class Index:
    """Index of an exemplar on its grid of places."""

    scale: Scale
    """Scale factors from maps to features."""
    bases: tuple[Basis, ...]
    """PCA basis from features to appearance vectors of each level, finest first."""
    similar: tuple[NDArray[np.int16], ...]
    """(H, W, 2) x, y in texels of each place's k-coherence candidate, of each level."""
    penalty: NDArray[np.uint8]
    """(H, W) of squares of 4 x 4 texels, square root of the placement cost in units of
    2^PENALTY_BITS (index.py); 255 excludes a place, 254 a mark."""
    lattice: PhasedLattice | None
    """Lattice of a regular texture, or None."""
    left_out: float
    """Share of the exemplar that stands out, such as stains."""
    rule: int = RULE
    """Version of the placement of patches (placement.py); older files have 1."""
    part: Frame | None = None
    """The part that fields may show, in texels of its grid; None for all."""
    aspect: float = 1.0
    """Width over height of patches (grain_aspect); older files have 1."""

    def stored(self) -> tuple[dict[str, NDArray[np.uint8]], dict[str, Any]]:
        """Tensors (bytes), and a description for JSON; the inverse of read()."""
        tensors = {"reluctance": pack(self.penalty)}
        for level, (basis, similar) in enumerate(zip(self.bases, self.similar, strict=True)):
            tensors[f"basis.{level}"] = pack(basis.weights)
            tensors[f"similar.{level}"] = pack(np.ascontiguousarray(similar.transpose(2, 0, 1)))
        about: dict[str, Any] = {
            "offsets": self.scale.offsets.tolist(),
            "factors": self.scale.factors.tolist(),
            "shifts": [basis.shift for basis in self.bases],
            "left_out": self.left_out,
            "waves": [],
        }
        if self.rule > 1:
            about["placement"] = self.rule
        if self.aspect != 1.0:
            about["aspect"] = self.aspect
        if self.part is not None:
            about["part"] = [self.part.left, self.part.top, self.part.right, self.part.bottom]
        if self.lattice is not None:
            about["waves"] = [list(wave) for wave in self.lattice.waves]
            tensors["bends"] = pack(self.lattice.phase_offsets)
        return tensors, about

    @staticmethod
    def read(
        about: Mapping[str, Any], tensor: Callable[[str], NDArray[np.uint8]], size: tuple[int, int]
    ) -> Index:
        """The index of what stored() returned.

        Args:
            tensor: returns the bytes of a name.
            size: (width, height) of the exemplar's grid of places.

        Raises:
            ValueError, KeyError, TypeError: an entry is missing, malformed or of another size.
        """
        width, height = size
        shifts = [int(shift) for shift in about["shifts"]]
        part = _part(about["part"], width, height) if "part" in about else None
        if not 1 <= len(shifts) <= level_count(*(part or Frame.of(width, height)).size):
            raise ValueError(f"{len(shifts)} levels of {width} x {height} texels")
        if not all(0 <= shift < 24 for shift in shifts):
            raise ValueError(f"shifts of {shifts}")
        bases, similar = [], []
        for level, shift in enumerate(shifts):
            weights = unpack(tensor(f"basis.{level}"), (DIMENSIONS, TAPS), np.int8)
            bases.append(Basis(weights, shift, step_of(level)))
            shape = (2, *_similar_shape(width, height, level))
            places = unpack(tensor(f"similar.{level}"), shape, np.int16)
            if int(places.min()) < 0 or not (places.max(axis=(1, 2)) < size).all():
                raise ValueError(f"similar places beyond {width} x {height} texels")
            similar.append(np.ascontiguousarray(places.transpose(1, 2, 0)))
        return Index(
            Scale(_floats(about["offsets"]), _floats(about["factors"])),
            tuple(bases),
            tuple(similar),
            unpack(tensor("reluctance"), _shape(width, height, COST_BITS), np.uint8),
            _lattice(about["waves"], tensor, width, height),
            float(about["left_out"]),
            _rule(about.get("placement", 1)),
            part,
            bounded(about.get("aspect", 1.0), "aspect", 1.0 / MOST_ASPECT, MOST_ASPECT),
        )


def build_index(
    exemplar: Exemplar,
    waves: tuple[Frequency, ...],
    *,
    straight: bool = False,
    part: Frame | None = None,
    one_light: bool = True,
) -> Index:
    """Compute the index of an exemplar.

    Args:
        exemplar: on its grid of places, of at least 14 texels a side.
        waves: approximate frequency vectors of its lattice, cycles per texel; or none.
        straight: whether they are exact, of a lattice without a bend.
        part: that fields may show, of at least 14 texels a side; None for all.
        one_light: whether relief is known along one direction at each place, so that what departs
            by a trend has a penalty (trend_penalty); else patches are placed by rule 1.
    """
    shown = part or Frame.of(*exemplar.size)
    planes = planes_of(exemplar)
    scale = choose_scale(planes)
    features = features_of(planes, scale)
    means = features.mean(axis=(1, 2), keepdims=True)
    centred = np.subtract(features, means, dtype=np.float32)
    lattice = measure_lattice(centred, waves, straight=straight)
    lattice = lattice and with_least_borders(centred, lattice)
    count = level_count(*shown.size)
    if lattice is not None:
        # Levels at which its patch is at least _FINENESS places wide.
        fine = math.floor(math.log2(lattice.patch_width() / _FINENESS)) + 1
        count = min(count, max(1, fine))
    grids = grids_of(features, count)

    def candidates_of(level: int) -> tuple[Basis, Candidates]:
        basis = choose_basis(grids[level], step_of(level))
        return basis, _similar(shown, level, project(grids[level], basis))

    of_levels = partial(at_once, *(partial(candidates_of, level) for level in range(count)))
    levels, penalty = at_once(of_levels, partial(_penalty, exemplar, planes if one_light else None))
    bases, candidates = [basis for basis, _ in levels], [each for _, each in levels]
    bits, coarsest = grid_bits(count - 1), project(grids[-1], bases[-1])
    outstanding = _outstanding(candidates, penalty < _KNOWN)
    stains = np.zeros_like(outstanding) if lattice else _stains(grids, penalty < _MOST)
    penalty = np.maximum(penalty, np.maximum(_MARK * outstanding, _DOUBTFUL * stains))
    places = [
        (np.stack([one.columns, one.rows], axis=-1) << similar_bits(level)).astype(np.int16)
        for level, one in enumerate(candidates)
    ]
    return Index(
        scale,
        tuple(bases),
        tuple(places),
        penalty.astype(np.uint8),
        lattice,
        round(float((outstanding | stains).mean()), 4),
        part=part,
        rule=RULE if one_light else 1,
        aspect=1.0 if lattice else grain_aspect(coarsest, frame_of(count - 1, shown), bits),
    )


def _similar(part: Frame, level: int, appearance: Appearance) -> Candidates:
    """Candidates of a level, on its candidate grid."""
    bits = similar_bits(level)
    skip = 1 << (bits - grid_bits(level))
    frame = frame_of(level, part)
    allowed = (
        slice(-(-frame.top >> bits), (frame.bottom >> bits) + 1),
        slice(-(-frame.left >> bits), (frame.right >> bits) + 1),
    )
    some = np.ascontiguousarray(appearance[::skip, ::skip])
    return find_candidates(some, max(_NEAREST_STEPS, _LEAST_TEXELS >> bits), allowed)


def _outstanding(candidates: list[Candidates], known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Places like no other: marks that the eye finds again wherever they recur, and stains.

    Their squared difference of appearance from their candidate is at some level more than
    _OUTSTANDING times the median, and among the largest _SMALL. (rows, columns) on the grid of
    placement costs.

    Args:
        candidates: of all levels.
        known: (rows, columns) squares that may be shown at all.
    """
    import cv2  # takes a tenth of a second, which synthesis is spared

    rarity = np.zeros(known.shape, np.float32)
    if not known.any():
        return np.zeros_like(known)
    for one in candidates[1:]:
        squares = one.distances.astype(np.float32)
        thin = np.asarray(cv2.resize(squares, known.shape[::-1], interpolation=cv2.INTER_AREA))
        rarity = np.maximum(rarity, thin / np.float32(np.median(thin[known]) + _ALIKE))
    least = max(_OUTSTANDING, float(np.quantile(rarity[known], 1.0 - _SMALL)))
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    return np.asarray(cv2.dilate((rarity > least).astype(np.uint8), cross) > 0)


def _stains(levels: list[FeatureMap], known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Stains and rings that fit into a patch: like others, but the eye sees that they recur.

    Longer features, such as veins, are none. (rows, columns) on the grid of placement costs.

    Args:
        levels: (PLANES, H, W) features of each, finest first.
        known: (rows, columns) squares that the photograph shows.
    """
    import cv2  # takes a tenth of a second, which synthesis is spared

    if not known.any():
        return np.zeros_like(known)
    level = min(_STAINED, len(levels) - 1)
    features, bits = levels[level], grid_bits(level)
    size = features.shape[:0:-1]
    seen = cv2.resize(known.astype(np.float32), size, interpolation=cv2.INTER_NEAREST)
    around = seen
    for _ in range(2):  # the second time, the mean is of what does not depart: no halo of a stain
        departure = np.zeros_like(seen)
        for plane in features[: SLOPES.start].astype(np.float32):
            sums, weights = (
                cv2.GaussianBlur(each, (0, 0), _AROUND / (1 << bits))
                for each in (plane * around, around)
            )
            off = np.abs(plane - sums / (weights + 1e-3)) * seen
            usual = 1.4826 * float(np.median(off[seen > 0.0])) + math.sqrt(_ALIKE) / 2.0
            departure = np.maximum(departure, off / usual)
        around = seen * (departure <= _DEPARTS)
    over = (departure > _DEPARTS).astype(np.uint8)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(over)
    peaks = np.zeros(count)
    np.maximum.at(peaks, np.asarray(labels, np.int64), departure)
    extent, area = boxes[:, 2:4].max(axis=1) * 2**bits, boxes[:, 4] * 4**bits
    chosen = (peaks > _PEAK) & (area > _AREA) & (_EXTENT[0] <= extent) & (extent <= _EXTENT[1])
    chosen[0] = False
    stains = chosen[labels].astype(np.uint8) * (chosen[labels].mean() <= _MOST_STAINED)
    stains = cv2.resize(stains, known.shape[::-1], interpolation=cv2.INTER_NEAREST)
    return np.asarray(cv2.dilate(stains, np.ones((3, 3), np.uint8)) > 0)


def _square_means(plane: NDArray[np.floating]) -> NDArray[np.floating]:
    """Averages over squares of 2^COST_BITS texels."""
    side = 1 << COST_BITS
    rows, columns = plane.shape
    whole = np.pad(plane, ((0, -rows % side), (0, -columns % side)), mode="edge")
    return whole.reshape(whole.shape[0] // side, side, -1, side).mean(axis=(1, 3))


def _penalty(exemplar: Exemplar, planes: NDArray[np.float32] | None) -> NDArray[np.float64]:
    """Penalties of low confidence, and of what departs by a trend of `planes`, if there is one."""
    penalty = _low_confidence(exemplar)
    if planes is None:
        return penalty
    return np.maximum(penalty, trend_penalty(planes, penalty < _KNOWN))


def _low_confidence(exemplar: Exemplar) -> NDArray[np.float64]:
    """Penalties of places of low confidence, (rows, columns) on the grid of placement costs.

    With c the geometric mean of confidence over maps, averaged over a square, the penalty rises
    from 0 at c = min(q - slack, h) to its maximum over the next (doubted - slack), q and h the
    quantiles `trusted` and `free` of c. So the better half of the exemplar has no penalty.
    """
    logs = np.log(exemplar.confidence + _LEAST_TRUST).mean(axis=0, dtype=np.float64)
    means = _square_means(np.exp(logs))
    # Quantiles are over places that the photograph shows.
    known = means[means > 1.5 * _LEAST_TRUST]
    most, half = np.quantile(known if known.size else means, (_TRUSTED, _FREE))
    short = (min(most - _SLACK, half) - means) / (_DOUBTED - _SLACK)
    return np.rint(_MOST * short.clip(0.0, 1.0))


def _shape(width: int, height: int, bits: int) -> tuple[int, int]:
    """(rows, columns) of a grid of 2^bits texels."""
    side = 1 << bits
    return -(-height // side), -(-width // side)


def _similar_shape(width: int, height: int, level: int) -> tuple[int, int]:
    """(rows, columns) of a level's candidate grid, which covers its appearance grid."""
    bits = grid_bits(level)
    return _shape(width >> bits, height >> bits, similar_bits(level) - bits)


def _part(stated: list[int], width: int, height: int) -> Frame:
    left, top, right, bottom = (int(edge) for edge in stated)
    if not (0 <= left <= right < width and 0 <= top <= bottom < height):
        raise ValueError(f"a part {stated} of {width} x {height} texels")
    return Frame(left, top, right, bottom)


def _rule(stated: int) -> int:
    if stated not in range(1, RULE + 1):
        raise ValueError(f"patches placed by rule {stated}")
    return int(stated)


def _floats(stated: list[float]) -> NDArray[np.float32]:
    values = np.array([float(value) for value in stated], np.float32)
    if values.shape != (PLANES,) or not bool((np.abs(values) < 1e9).all()):
        raise ValueError(f"a scale of {stated}")
    return values


def _lattice(
    waves: list[list[float]], tensor: Callable[[str], NDArray[np.uint8]], width: int, height: int
) -> PhasedLattice | None:
    if not waves:
        return None
    vectors = tuple((float(fx), float(fy)) for fx, fy in waves[:2])
    lengths = [math.hypot(*wave) for wave in vectors]
    if not all(1e-4 < length < 1.0 for length in lengths):
        raise ValueError(f"waves of {waves}")
    if len(vectors) == 2:
        (ax, ay), (bx, by) = vectors
        if abs(ax * by - ay * bx) < 0.01 * lengths[0] * lengths[1]:
            raise ValueError(f"waves in one direction, {waves}")
    rows, columns = (side + 1 for side in _shape(width, height, GRID))
    return PhasedLattice(vectors, unpack(tensor("bends"), (len(vectors), rows, columns), np.int32))


# Tables that the synthesis reads, by level, computed from an exemplar and its index.
#
# A level is a grid of the field with a spacing of 2^level texels. Its neighbourhoods are compared
# by the appearance of the exemplar smoothed to that spacing, sampled at half of it.

_ORDERED = 1  # first level at which phase errors have a cost
# Placement cost is penalty^2 * 2^cost_bits: 1.3e8 at the penalty 255, more than any seam; 4e5 at
# 14, as much as a common seam.
PENALTY_BITS = 11
# Penalties in corrections of patches that are fitted, for the sake of long structure: at the full
# cost corrections break the patches up, and show the few places without a penalty over and over.
# Up to _DOUBTFUL a penalty costs less than a seam.
_SEAM, _DOUBTFUL, _MARKED = {3: 20, 4: 10}, 60, 40  # by rule of placement
_SPARED = 16  # at most 1 / 16 of the frame is left out at either end, so that opposite borders fit


def _softened(rule: int) -> NDArray[np.int32]:
    """Penalty in corrections by the penalty of a patch, of a rule of placement."""
    steep = (np.arange(_MOST + 1) - _DOUBTFUL) * _MOST // (_MOST - _DOUBTFUL)
    soft = np.minimum(np.arange(_MOST + 1), _SEAM[rule])
    softened = np.maximum(soft, steep).astype(np.int32)
    softened[_MARK] = _MARKED
    return softened


@dataclass(frozen=True)
class Level:
    """Tables of one level."""

    spacing: int
    """Texels between places of the field."""
    frame: Frame
    """Limits of places."""
    bits: int
    """log2 of the appearance grid's step in texels."""
    appearance: Appearance
    """(H, W, DIMENSIONS) appearance vectors of the exemplar's places."""
    similar_bits: int
    """log2 of the candidate grid's step in texels."""
    similar_shift: int
    """The mismatch of candidates counts 2^similar_shift times that of continuations, so that
    patches stay large."""
    similar: NDArray[np.int16]
    """(H, W, 2) k-coherence candidates, x, y in texels."""
    placement_cost: NDArray[np.int32]
    """(H, W) of squares of 2^COST_BITS texels, added to the mismatch."""
    phases: Phases | None
    """(H, W, 2) on the appearance grid; None where the level keeps to no lattice."""


@dataclass(frozen=True)
class Lookup:
    """Tables of all levels."""

    levels: tuple[Level, ...]
    """Levels of the pyramid, finest first."""
    lattice: PhasedLattice | None
    sizes: PatchSizes
    """Sizes of the coarsest level's patches."""
    joined: Frame
    """The part of its frame of which opposite borders adjoin."""
    placement: Placement
    """Costs of the centres of its patches."""
    cost: NDArray[np.int32]
    """(H, W) of squares of 2^COST_BITS texels: what a patch that shows them costs."""

    def sized(self, sizes: PatchSizes) -> Lookup:
        """The tables of patches of other sizes."""
        placement = _placement(self.cost, self.lattice, sizes, self.joined, self.rule)
        return replace(self, sizes=sizes, placement=placement)

    def of_rule_2(self) -> Lookup:
        """The tables by rule 2 of placement, or 1 if they are by that."""
        levels = (replace(one, placement_cost=self.cost, similar_shift=1) for one in self.levels)
        placement = replace(self.placement, rule=min(self.rule, 2))
        return replace(self, levels=tuple(levels), placement=placement)

    @property
    def rule(self) -> int:
        """Version of the placement of patches."""
        return self.placement.rule


def _placement(
    cost: NDArray[np.int32],
    lattice: PhasedLattice | None,
    sizes: PatchSizes,
    joined: Frame,
    rule: int,
) -> Placement:
    sides = sizes.width, sizes.height
    if lattice is not None:
        wide, high = lattice.patch_extent(sizes.cells)
        sides = round(wide), round(high)
    loose = sizes.loose or lattice is not None
    return Placement.of(cost, rule, sides, None if loose else joined)


def prepare(exemplar: Exemplar, index: Index, variety: float = 1.0) -> Lookup:
    """Compute the tables of an exemplar.

    Args:
        exemplar: on its grid of places.
        variety: in [0, 1].
    """
    part = index.part or Frame.of(*exemplar.size)
    grids = grids_of(features_of(planes_of(exemplar), index.scale), len(index.bases))
    appearances = at_once(*(partial(project, *one) for one in zip(grids, index.bases, strict=True)))
    cost = np.square(index.penalty, dtype=np.int32) << PENALTY_BITS
    lattice, coarsest = kept_lattice(index, variety), len(appearances) - 1
    frame = frame_of(coarsest, part)
    sizes = PatchSizes.of(frame, 1 << coarsest, lattice, variety, index.aspect)
    whole = index.rule > 2 and not sizes.loose
    corrected = cost
    if whole:
        corrected = np.square(_softened(index.rule)[index.penalty]) << PENALTY_BITS
    levels = tuple(
        Level(
            spacing=1 << level,
            frame=frame_of(level, part),
            bits=grid_bits(level),
            appearance=appearance,
            similar_bits=similar_bits(level),
            similar_shift=2 if whole else 1,
            similar=similar,
            placement_cost=corrected,
            phases=_phases(lattice, level, appearance),
        )
        for level, (appearance, similar) in enumerate(zip(appearances, index.similar, strict=True))
    )
    joined = _joined_frame(levels[-1])
    placement = _placement(cost, lattice, sizes, joined, index.rule)
    return Lookup(levels, lattice, sizes, joined, placement, cost)


def kept_lattice(index: Index, variety: float) -> PhasedLattice | None:
    """The lattice that patches are aligned with; None at variety 0, where the exemplar repeats."""
    return index.lattice if variety > 0.0 else None


def _joined_frame(level: Level) -> Frame:
    """The part of a level's frame of which opposite borders differ least in appearance."""
    frame, bits = level.frame, level.bits
    rows = slice(frame.top >> bits, (frame.bottom >> bits) + 1)
    inside = level.appearance[rows, frame.left >> bits : (frame.right >> bits) + 1].astype(np.int64)
    top, bottom = _least_step(inside)
    left, right = _least_step(inside[top:bottom].swapaxes(0, 1))
    return Frame(
        frame.left + (left << bits),
        frame.top + (top << bits),
        frame.left + (right << bits) - 1,
        frame.top + (bottom << bits) - 1,
    )


def _least_step(rows: NDArray[np.int64]) -> tuple[int, int]:
    """First row, and the one after the last, of which the second continues the last best."""
    spared = len(rows) // _SPARED
    first, after = rows[: spared + 1, None], rows[None, len(rows) - 1 - spared :]
    differences = np.square(first - after).sum(axis=(2, 3))
    begin, end = np.unravel_index(int(np.argmin(differences)), differences.shape)
    return int(begin), len(rows) - 1 - spared + int(end)


def _phases(lattice: PhasedLattice | None, level: int, appearance: Appearance) -> Phases | None:
    if lattice is None or level < _ORDERED:
        return None
    rows, columns = (np.arange(n) << grid_bits(level) for n in appearance.shape[:2])
    return two_phases(lattice.phases(columns[None, :], rows[:, None]))


def two_phases(phases: Phases) -> Phases:
    """(..., 2) phases; with one wave the second is 0."""
    return np.pad(phases, ((0, 0), (0, 0), (0, 2 - phases.shape[-1])))
