"""No integer of the field by example can overflow: by bounds, and at them, in a million draws.

Every reference is in int64, where nothing of this could.
"""

import numpy as np
import plain_loops as plain
import pytest
from plain_loops import DIAGONALS, PHASE_SHIFT, SIMILAR_TIMES

from matcap.example.appearance import DIMENSIONS, LARGEST, TAPS, Basis, project
from matcap.example.correction import correct
from matcap.example.features import LIMIT, PLANES
from matcap.example.grids import COST_BITS, Frame
from matcap.example.lookup import PENALTY_BITS, Level

INT16, INT32 = 2**15 - 1, 2**31 - 1
SIDE = 1024  # places of a draw: a million of them
MOST_PRICE = 255**2 << PENALTY_BITS
MOST_TURN = 2**15 >> PHASE_SHIFT


def test_the_largest_sums_fit() -> None:
    difference = 3 * 2 * LARGEST
    assert difference <= INT16
    seams = SIMILAR_TIMES * len(DIAGONALS) * DIMENSIONS * difference**2
    assert seams + 2 * MOST_TURN**2 + MOST_PRICE < INT32
    assert TAPS * LIMIT * LIMIT < 2**24  # exact in float32, too


def extreme(draw: np.random.Generator) -> Level:
    """A level whose every number is as large as it may be, in one direction or the other."""
    ends = np.array([-LARGEST, LARGEST], np.int16)
    return Level(
        spacing=2,
        frame=Frame(8, 8, SIDE - 9, SIDE - 9),
        bits=0,
        appearance=draw.choice(ends, (SIDE, SIDE, DIMENSIONS)),
        similar_bits=1,
        similar=draw.integers(8, SIDE - 10, (SIDE // 2, SIDE // 2, 2)).astype(np.int16),
        placement_cost=np.full((SIDE >> COST_BITS, SIDE >> COST_BITS), MOST_PRICE, np.int32),
        phases=draw.choice(np.array([0, -(2**15)], np.int16), (SIDE, SIDE, 2)),
    )


def test_a_million_costs_are_those_of_wider_integers() -> None:
    draw = np.random.default_rng(0)
    level = extreme(draw)
    places = draw.integers(8, SIDE - 9, (SIDE, SIDE, 2)).astype(np.int32)
    wanted = [
        draw.choice(np.array([-3, 3], np.int32) * LARGEST, (SIDE, SIDE, DIMENSIONS))
        for _ in DIAGONALS
    ]
    ordered = draw.choice(np.array([0, -(2**15)], np.int16), (SIDE, SIDE, 2))
    found = plain._cost(level, places, wanted, ordered, similar=True)
    x, y = places[..., 0], places[..., 1]
    expected = np.full((SIDE, SIDE), MOST_PRICE, np.int64)
    for (down, across), target in zip(DIAGONALS, wanted, strict=True):
        there = level.appearance[y + 2 * down, x + 2 * across].astype(np.int64)
        expected += SIMILAR_TIMES * np.square(3 * there - target).sum(-1)
    assert level.phases is not None
    half = level.phases[y, x] != ordered
    expected += MOST_TURN**2 * half.sum(-1)
    assert np.array_equal(found, expected)
    assert 0.5 * INT32 < expected.max() < INT32  # draws come near the bound


@pytest.mark.parametrize("form", [plain.correct, correct])
def test_correction_at_the_bounds_stays_where_places_may_lie(form) -> None:
    draw = np.random.default_rng(1)
    level = extreme(draw)
    places = draw.integers(8, SIDE - 9, (96, 96, 2)).astype(np.int16)
    odd = np.arange(96) % 2 == 1
    phases = draw.choice(np.array([0, -(2**15)], np.int16), (96, 96, 2))
    found = form(places, level, odd, odd, 1, phases)
    assert np.array_equal(found, plain.correct(places, level, odd, odd, 1, phases))
    frame = level.frame
    assert frame.left <= found[..., 0].min() and found[..., 0].max() <= frame.right
    assert frame.top <= found[..., 1].min() and found[..., 1].max() <= frame.bottom


@pytest.mark.parametrize("project", [project, plain.project])
def test_the_largest_features_are_projected_exactly(project) -> None:
    draw = np.random.default_rng(2)
    basis = Basis(np.full((DIMENSIONS, TAPS), LIMIT, np.int8), 0, 1)
    features = np.full((PLANES, 32, 48), LIMIT, np.int16)
    assert np.all(project(features, basis) == LARGEST)
    signs = draw.choice(np.array([-1, 1], np.int16), (PLANES, 32, 48))
    # All sums are multiples of 127^2, and shifted down so far that none is clipped.
    found = project(features * signs, Basis(basis.weights, 13, 1))
    around = np.pad((features * signs).astype(np.int64), ((0, 0), (2, 2), (2, 2)), mode="symmetric")
    sums = sum(around[:, y : y + 32, x : x + 48].sum(0) for y in range(5) for x in range(5))
    assert np.array_equal(found[..., 0], (LIMIT * sums) >> 13)
