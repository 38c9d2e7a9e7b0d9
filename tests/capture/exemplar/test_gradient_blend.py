"""Copied texels meet without steps, and keep what they draw."""

import numpy as np
import pytest

from matcap.capture.exemplar.inpaint import composed

SIZE = 64
FREE = np.zeros((SIZE, SIZE), bool)
FREE[24:40, 24:40] = True


def copied_from(rows, columns):
    """Every free texel is of the one so many rows and columns away."""
    source = np.indices((SIZE, SIZE))
    source[:, FREE] += np.array([rows, columns])[:, None]
    return source


def test_what_is_moved_to_where_it_continues_is_exact():
    """A period away all is the same."""
    y, x = np.mgrid[:SIZE, :SIZE].astype(np.float32)
    maps = np.stack([np.sin(2 * np.pi * x / 16), np.cos(2 * np.pi * (x + y) / 16)])
    torn = np.where(FREE, 9.0, maps)
    result = composed(torn.astype(np.float32), copied_from(-16, 0), FREE, 20.0)
    assert result == pytest.approx(maps, abs=1e-4)


def test_a_drift_leaves_no_step_and_no_change_of_what_is_drawn():
    rng = np.random.default_rng(1)
    drawn = rng.normal(0.0, 0.1, (1, SIZE, SIZE))
    maps = (drawn + np.linspace(0.0, 3.0, SIZE)[None, None]).astype(np.float32)
    source = copied_from(0, 20)
    plain = maps[:, source[0], source[1]]
    blended = composed(maps, source, FREE, 20.0)

    def step(picture):
        edge = np.abs(picture[0, 24:40, 24] - picture[0, 24:40, 23]).mean()
        return edge / np.abs(np.diff(maps[0], axis=1)).mean()

    assert step(plain) > 4.0 and step(blended) < 1.5
    inside = (0, slice(26, 38), slice(26, 38))
    kept = np.corrcoef(np.diff(plain[inside]).ravel(), np.diff(blended[inside]).ravel())[0, 1]
    assert kept > 0.98
    assert np.array_equal(blended[:, ~FREE], maps[:, ~FREE])


def test_far_from_a_seam_the_source_decides():
    """`reach` texels away most of a step is forgotten, and several of them away all of it."""
    maps = np.zeros((1, SIZE, SIZE), np.float32)
    maps[:, :, :8] = 1.0
    source = copied_from(0, 0)
    source[1][FREE] = 2
    middle = composed(maps, source, FREE, 1.5)[0, 32, 32]
    assert middle == pytest.approx(1.0, abs=0.02)


def test_nothing_free_is_the_same_object():
    maps = np.ones((2, SIZE, SIZE), np.float32)
    assert composed(maps, copied_from(0, 0), np.zeros_like(FREE), 10.0) is maps
