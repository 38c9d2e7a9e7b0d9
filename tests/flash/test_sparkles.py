"""Lone sparkles above white become lower bounds; highlights and files that clip at white do not."""

import math
from dataclasses import replace

import numpy as np
import pytest

from matcap.flash.highlight import limit_sparkles
from matcap.photo.photo import Photo

ROWS, COLUMNS = 240, 320


def photo_of(light, headroom=math.inf) -> Photo:
    return Photo(
        pixels=np.repeat(light[..., None], 3, axis=2).astype(np.float32),
        clipped=np.zeros(light.shape, bool),
        fov=66.0,
        fov_source="given",
        radiometric=False,
        name="a.exr",
        original_size=(COLUMNS, ROWS),
        headroom=headroom,
    )


def spot(width: float, peak: float) -> np.ndarray:
    """(H, W) light under a flash whose highlight has this standard deviation, plane units."""
    y, x = np.mgrid[0:ROWS, 0:COLUMNS]
    squared = ((x - COLUMNS / 2) ** 2 + (y - ROWS / 2) ** 2) * (2.0 / COLUMNS) ** 2
    return 0.2 * np.exp(-0.5 * squared) + peak * np.exp(-0.5 * squared / width**2)


@pytest.fixture
def sparkling() -> tuple[np.ndarray, np.ndarray]:
    """Light with sparkles on a twentieth of the pixels, and where they are."""
    at = np.random.default_rng(0).random((ROWS, COLUMNS)) < 0.02
    return np.where(at, 20.0, spot(0.2, 0.3)), at


def test_sparkles_become_lower_bounds(sparkling):
    light, at = sparkling
    limited = limit_sparkles(photo_of(light))
    np.testing.assert_array_equal(limited.clipped, at)
    assert limited.pixels[at].max() < 3.0 and limited.full[at].all()
    np.testing.assert_array_equal(limited.pixels[~at][:, 0], light[~at].astype(np.float32))


@pytest.mark.parametrize("width", [0.02, 0.04, 0.1, 0.3])
def test_highlights_are_no_sparkles(width):
    limited = limit_sparkles(photo_of(spot(width, 12.0)))
    assert limited.clipped.mean() < 1e-3 and limited.pixels.max() > 11.0


def test_files_that_clip_at_white_are_unchanged(sparkling):
    light, _ = sparkling
    photo = replace(photo_of(np.minimum(light, 1.0)), headroom=1.0)
    assert limit_sparkles(photo) is photo
    dim = photo_of(0.04 * light)
    assert limit_sparkles(dim) is dim
