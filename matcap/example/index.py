"""Index of an exemplar: PCA bases, k-coherence candidates and penalties, computed once at capture.

What follows from these by exact arithmetic is not stored but computed again (lookup.py); appearance
vectors alone would take 30 megabytes.

Places of low confidence, and those that stand out, such as stains, have penalties: patches are not
placed there, and seams avoid them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.example.appearance import DIMENSIONS, TAPS, Appearance, Basis, choose_basis, project
from matcap.example.candidates import Candidates, find_candidates
from matcap.example.exemplar import Exemplar
from matcap.example.features import (
    PLANES,
    Scale,
    choose_scale,
    features_of,
    planes_of,
)
from matcap.example.grids import (
    COST_BITS,
    frame_of,
    grid_bits,
    grids_of,
    level_count,
    similar_bits,
    step_of,
)
from matcap.example.lattice import GRID, Frequency, PhasedLattice, measure_lattice
from matcap.example.packed import pack, unpack

# Candidates and penalties of an exemplar; docs/notes/field.md.
_LEAST_STEPS = 4  # least distance between a place and its candidate, grid steps
_LEAST_TEXELS = 8  # likewise, texels
_FINENESS = 16  # least number of places along the shorter side of a lattice's patch
# Median absolute deviations of a band of brightness from which places stand out (of a Gaussian, 4
# standard deviations), and the bands' octaves of squares of 4 x 4 texels.
_OUTSTANDING, _OCTAVES = 6.0, (1, 2, 3, 4)
# Most such regions of a band, and their largest share: others belong to the material (specks of a
# glaze are 15, rivets 25, stains 1 to 7, the dark edge of a tile 8 %).
_FEW, _SMALL = 8, 0.1
_INVISIBLE = 3e-4  # added to the median absolute deviation, square root of albedo
_LEAST_TRUST = 0.02  # added to a map's confidence before the logarithm
_TRUSTED = 0.8  # quantile of the confidence that places are compared with
_SLACK = 0.05  # confidence below that quantile without a penalty
_DOUBTED = 0.35  # confidence below that quantile at which the penalty is largest
# Least share of places without a penalty. More uses places of wrong maps, less has too few
# places to choose from.
_FREE = 0.5

_MOST = 255


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
    2^PENALTY_BITS (lookup.py); 255 excludes a place."""
    lattice: PhasedLattice | None
    """Lattice of a regular texture, or None."""
    left_out: float
    """Share of the exemplar that stands out, such as stains."""

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
            about: the description.
            tensor: returns the bytes of a name.
            size: (width, height) of the exemplar's grid of places.

        Raises:
            ValueError, KeyError, TypeError: an entry is missing, malformed or of another size.
        """
        width, height = size
        shifts = [int(shift) for shift in about["shifts"]]
        if not 1 <= len(shifts) <= level_count(width, height):
            raise ValueError(f"{len(shifts)} levels of {width} x {height} texels")
        if not all(0 <= shift < 24 for shift in shifts):
            raise ValueError(f"shifts of {shifts}")
        bases, similar = [], []
        for level, shift in enumerate(shifts):
            weights = unpack(tensor(f"basis.{level}"), (DIMENSIONS, TAPS), np.int8)
            bases.append(Basis(weights, shift, step_of(level)))
            shape = (2, *_similar_shape(width, height, level))
            places = unpack(tensor(f"similar.{level}"), shape, np.int16)
            _check_places(places, width, height)
            similar.append(np.ascontiguousarray(places.transpose(1, 2, 0)))
        return Index(
            Scale(_floats(about["offsets"]), _floats(about["factors"])),
            tuple(bases),
            tuple(similar),
            unpack(tensor("reluctance"), _shape(width, height, COST_BITS), np.uint8),
            _lattice(about["waves"], tensor, width, height),
            float(about["left_out"]),
        )


def build_index(
    exemplar: Exemplar, waves: tuple[Frequency, ...], *, straight: bool = False
) -> Index:
    """Compute the index of an exemplar.

    Args:
        exemplar: on its grid of places, of at least 14 texels a side.
        waves: approximate frequency vectors of its lattice, cycles per texel; or none.
        straight: whether they are exact, of a lattice without a bend.
    """
    width, height = exemplar.size
    planes = planes_of(exemplar)
    scale = choose_scale(planes)
    features = features_of(planes, scale)
    means = features.mean(axis=(1, 2), keepdims=True)
    centred = np.subtract(features, means, dtype=np.float32)
    lattice = measure_lattice(centred, waves, straight=straight)
    count = level_count(width, height)
    if lattice is not None:
        count = min(count, _ordered_levels(lattice))
    grids = grids_of(features, count)
    steps = [step_of(level) for level in range(count)]
    with ThreadPoolExecutor() as pool:
        bases = list(pool.map(choose_basis, grids, steps))
        appearances = list(pool.map(project, grids, bases))
        candidates = list(pool.map(partial(_similar, width, height), range(count), appearances))
    outstanding = _outstanding(planes[:3].mean(axis=0))
    penalty = np.maximum(_low_confidence(exemplar), _MOST * outstanding)
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
        round(float(outstanding.mean()), 4),
    )


def _ordered_levels(lattice: PhasedLattice) -> int:
    """Number of levels at which a lattice's patch is at least _FINENESS places wide."""
    return max(1, math.floor(math.log2(lattice.patch_width() / _FINENESS)) + 1)


def _similar(width: int, height: int, level: int, appearance: Appearance) -> Candidates:
    """Candidates of a level, on its candidate grid."""
    bits = similar_bits(level)
    skip = 1 << (bits - grid_bits(level))
    frame = frame_of(level, width, height)
    allowed = (
        slice(-(-frame.top >> bits), (frame.bottom >> bits) + 1),
        slice(-(-frame.left >> bits), (frame.right >> bits) + 1),
    )
    some = np.ascontiguousarray(appearance[::skip, ::skip])
    return find_candidates(some, max(_LEAST_STEPS, _LEAST_TEXELS >> bits), allowed)


def _outstanding(brightness: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Places of stains: few regions much brighter or darker than the rest, at any scale.

    Band b_k = G(2^k) * B - G(2^(k + 1)) * B of the square root B of albedo (plus F0 where it has a
    colour), averaged over squares; places where |b_k - median| > _OUTSTANDING median absolute
    deviations, if they are at most _FEW connected regions and a share of _SMALL. (rows, columns)
    on the grid of placement costs.
    """
    import cv2  # takes a tenth of a second, which synthesis is spared

    means = _square_means(brightness).astype(np.float32)
    blurred = {k: cv2.GaussianBlur(means, (0, 0), 2.0**k) for k in (*_OCTAVES, _OCTAVES[-1] + 1)}
    stains = np.zeros(means.shape, np.bool_)
    for k in _OCTAVES:
        band = blurred[k] - blurred[k + 1]
        distance = np.abs(band - np.median(band))
        far = distance > _OUTSTANDING * (np.median(distance) + _INVISIBLE)
        regions = cv2.connectedComponents(far.astype(np.uint8))[0] - 1
        if regions <= _FEW and far.mean() <= _SMALL:
            stains |= far
    return stains


def _square_means(plane: NDArray[np.floating]) -> NDArray[np.floating]:
    """Averages over squares of 2^COST_BITS texels."""
    side = 1 << COST_BITS
    rows, columns = plane.shape
    whole = np.pad(plane, ((0, -rows % side), (0, -columns % side)), mode="edge")
    return whole.reshape(whole.shape[0] // side, side, -1, side).mean(axis=(1, 3))


def _low_confidence(exemplar: Exemplar) -> NDArray[np.float64]:
    """Penalties of places of low confidence, (rows, columns) on the grid of placement costs.

    With c the geometric mean of confidence over maps, averaged over a square, the penalty rises
    from 0 at c = min(q - slack, h) to its maximum over the next (doubted - slack), q and h the
    quantiles `trusted` and `free` of c. So the better half of the exemplar has no penalty.
    """
    means = _square_means(
        np.exp(np.log(exemplar.confidence + _LEAST_TRUST).mean(axis=0, dtype=np.float64))
    )
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


def _check_places(places: NDArray[np.int16], width: int, height: int) -> None:
    x, y = places
    if int(places.min()) < 0 or int(x.max()) >= width or int(y.max()) >= height:
        raise ValueError(f"similar places beyond {width} x {height} texels")


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
