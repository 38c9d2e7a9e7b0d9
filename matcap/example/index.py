"""Index of an exemplar: PCA bases, candidates and placement costs, computed once at capture.

What follows from the exemplar and these choices by exact arithmetic is not kept, but made again
(lookup.py): appearances alone would take 30 megabytes.

Places that are hardly trusted, and marks that occur once, are reluctant: pieces begin elsewhere,
and seams lead round them.
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
from matcap.example.exemplar import Exemplar
from matcap.example.features import (
    PLANES,
    Scale,
    choose_scale,
    features_of,
    planes_of,
)
from matcap.example.grids import (
    PRICE_BITS,
    frame_of,
    grid_bits,
    grids_of,
    level_count,
    similar_bits,
    step_of,
)
from matcap.example.order import GRID, Frequency, Order, measure_order
from matcap.example.packed import pack, unpack
from matcap.example.similar import Similar, find_similar
from matcap.example.tuned import INDEX

_MOST = 255


@dataclass(frozen=True)
class Index:
    """What was chosen for an exemplar."""

    scale: Scale
    """From maps to features."""
    bases: tuple[Basis, ...]
    """Per level, the finest first, from features to appearance."""
    similar: tuple[NDArray[np.int16], ...]
    """Per level (H, W, 2) int16: x, y of the most similar place in texels."""
    reluctance: NDArray[np.uint8]
    """(H, W) uint8 of squares of 4 x 4 texels; 255 where pieces must not begin."""
    order: Order | None
    """The lattice to keep, or None."""
    left_out: float
    """Share of the exemplar that matches nothing else."""

    def stored(self) -> tuple[dict[str, NDArray[np.uint8]], dict[str, Any]]:
        """Tensors (bytes) and a description for JSON, from which read() makes it again."""
        tensors = {"reluctance": pack(self.reluctance)}
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
        if self.order is not None:
            about["waves"] = [list(wave) for wave in self.order.waves]
            tensors["bends"] = pack(self.order.bends)
        return tensors, about

    @staticmethod
    def read(
        about: Mapping[str, Any], tensor: Callable[[str], NDArray[np.uint8]], size: tuple[int, int]
    ) -> Index:
        """An index from what stored() gave.

        Args:
            about: the description.
            tensor: gives bytes, by their name.
            size: (width, height) of the exemplar's grid that it is for.

        Raises:
            ValueError, KeyError, TypeError: it is not as it should be, or for another size.
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
            unpack(tensor("reluctance"), _shape(width, height, PRICE_BITS), np.uint8),
            _order(about["waves"], tensor, width, height),
            float(about["left_out"]),
        )


def build_index(exemplar: Exemplar, waves: tuple[Frequency, ...]) -> Index:
    """The index of an exemplar.

    Args:
        exemplar: of at least 14 texels a side.
        waves: about where those of its regular order are; none for most materials.
    """
    width, height = exemplar.size
    planes = planes_of(exemplar)
    scale = choose_scale(planes)
    features = features_of(planes, scale)
    means = features.mean(axis=(1, 2), keepdims=True)
    order = measure_order(np.subtract(features, means, dtype=np.float32), waves)
    count = level_count(width, height)
    if order is not None:
        count = min(count, _ordered_levels(order))
    grids = grids_of(features, count)
    steps = [step_of(level) for level in range(count)]
    with ThreadPoolExecutor() as pool:
        bases = list(pool.map(choose_basis, grids, steps))
        appearances = list(pool.map(project, grids, bases))
        candidates = list(pool.map(partial(_similar, width, height), range(count), appearances))
    unique = _unique(candidates[min(INDEX.unique_level, count - 1)])
    reluctance = np.maximum(_doubt(exemplar), _MOST * _resized(unique, width, height))
    places = [
        (np.stack([one.columns, one.rows], axis=-1) << similar_bits(level)).astype(np.int16)
        for level, one in enumerate(candidates)
    ]
    return Index(
        scale,
        tuple(bases),
        tuple(places),
        reluctance.astype(np.uint8),
        order,
        round(float(unique.mean()), 4),
    )


def _ordered_levels(order: Order) -> int:
    """Levels that pieces of a lattice are drawn finely enough at."""
    return max(1, math.floor(math.log2(order.piece() / INDEX.fineness)) + 1)


def _similar(width: int, height: int, level: int, appearance: Appearance) -> Similar:
    bits = similar_bits(level)
    skip = 1 << (bits - grid_bits(level))
    frame = frame_of(level, width, height)
    allowed = (
        slice(-(-frame.top >> bits), (frame.bottom >> bits) + 1),
        slice(-(-frame.left >> bits), (frame.right >> bits) + 1),
    )
    some = np.ascontiguousarray(appearance[::skip, ::skip])
    return find_similar(some, max(INDEX.least_steps, INDEX.least_texels >> bits), allowed)


def _unique(similar: Similar) -> NDArray[np.bool_]:
    """Places that nothing else is like."""
    distances = similar.distances.astype(np.float64)
    return distances > INDEX.unique * max(float(np.median(distances)), 1.0)


def _doubt(exemplar: Exemplar) -> NDArray[np.float64]:
    """Reluctance of places that are less trusted than most."""
    side = 1 << PRICE_BITS
    # A place is worth no more than its worst maps: the geometric mean.
    trust = np.exp(np.log(exemplar.confidence + INDEX.least_trust).mean(axis=0, dtype=np.float64))
    rows, columns = trust.shape
    whole = np.pad(trust, ((0, -rows % side), (0, -columns % side)), mode="edge")
    means = whole.reshape(whole.shape[0] // side, side, -1, side).mean(axis=(1, 3))
    # What is none of the material, or was never seen, is no measure of the rest.
    known = means[means > 1.5 * INDEX.least_trust]
    most, half = np.quantile(known if known.size else means, (INDEX.trusted, INDEX.free))
    # From what is hardly half of a piece no cell closes: the better half is never priced.
    short = (min(most - INDEX.slack, half) - means) / (INDEX.doubted - INDEX.slack)
    return np.rint(_MOST * short.clip(0.0, 1.0))


def _resized(marks: NDArray[np.bool_], width: int, height: int) -> NDArray[np.bool_]:
    """Marks of any grid of the exemplar on that of prices: the nearest."""
    rows, columns = _shape(width, height, PRICE_BITS)
    y = (np.arange(rows) * marks.shape[0] // rows).clip(0, marks.shape[0] - 1)
    x = (np.arange(columns) * marks.shape[1] // columns).clip(0, marks.shape[1] - 1)
    return marks[np.ix_(y, x)]


def _shape(width: int, height: int, bits: int) -> tuple[int, int]:
    """(rows, columns) of a grid of squares of 2^bits texels."""
    side = 1 << bits
    return -(-height // side), -(-width // side)


def _similar_shape(width: int, height: int, level: int) -> tuple[int, int]:
    """(rows, columns) of a level's similar places: its appearance's grid is rounded down."""
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


def _order(
    waves: list[list[float]], tensor: Callable[[str], NDArray[np.uint8]], width: int, height: int
) -> Order | None:
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
    return Order(vectors, unpack(tensor("bends"), (len(vectors), rows, columns), np.int32))
