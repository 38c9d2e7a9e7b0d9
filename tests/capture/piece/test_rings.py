"""Marks in rings around the flash's foot are taken off, drawings are left."""

from __future__ import annotations

import numpy as np
import pytest

from matcap.capture.piece.rings import Rings

SHAPE, FOOT = (144, 192), (0.1, -0.05)


def away():
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5
    x, y = 2.0 * u / SHAPE[1] - 1.0 - FOOT[0], (SHAPE[0] - 2.0 * v) / SHAPE[1] - FOOT[1]
    return np.hypot(x, y)


MARKS = {
    "ring": 0.3 * np.exp(-np.square((away() - 0.3) / 0.08)),
    "disc": 0.3 / (1.0 + np.exp((away() - 0.25) / 0.03)),
}


@pytest.mark.parametrize("mark", MARKS.values(), ids=MARKS)
def test_a_mark_is_taken_off_though_grain_lies_over_it(mark):
    grain = np.random.default_rng(1).normal(0.0, 0.1, SHAPE)
    taken = Rings.around(FOOT, SHAPE).marked((mark + grain).astype(np.float32))
    left = mark - mark.mean() - taken
    there = mark > 0.05
    assert np.sqrt(np.mean(left[there] ** 2)) < 0.2 * np.sqrt(np.mean(mark[there] ** 2))


@pytest.mark.parametrize("grain", [1, 12, 40])
def test_a_drawing_is_left_as_it_is_however_coarse(grain):
    rng = np.random.default_rng(2)
    size = [-(-side // grain) for side in SHAPE]
    cells = np.kron(rng.normal(0.0, 0.2, size), np.ones((grain, grain)))[: SHAPE[0], : SHAPE[1]]
    taken = Rings.around(FOOT, SHAPE).marked(cells.astype(np.float32))
    assert np.mean(taken**2) < 0.02 * np.mean(cells**2)


def test_a_line_through_the_foot_is_a_drawing():
    line = np.zeros(SHAPE, np.float32)
    line[70:76] = 0.5
    taken = Rings.around(FOOT, SHAPE).marked(line)
    assert np.mean(taken**2) < 0.05 * np.mean((line - line.mean()) ** 2)


def test_a_feature_that_lies_at_the_foot_is_a_drawing():
    spot = 0.5 * (away() < 0.05)
    taken = Rings.around(FOOT, SHAPE).marked(spot.astype(np.float32))
    assert np.abs(taken).max() < 0.1
