import math

import numpy as np
import pytest

from matcap_lab.simulate.procedural import Canvas, Spectrum, bumps, cells, noise, weave

TEXEL = 2.0 / 256.0
CANVAS = Canvas(256, 192, TEXEL, seed=3)
SPECTRUM = Spectrum(coarse=0.1, fine=0.03)


def test_noise_has_the_unit_it_promises():
    field = noise(CANVAS, "a", SPECTRUM)
    assert abs(field.mean()) < 1e-12
    assert field.std() == pytest.approx(1.0, abs=0.1)


def test_bumps_have_unit_slope():
    down, right = np.gradient(bumps(CANVAS, "a", SPECTRUM), TEXEL)
    assert math.sqrt((down**2 + right**2).mean()) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_a_finer_grid_shows_the_same_noise_and_cells(angle):
    """Photographs are shaded finer than the true maps are stored."""
    fine = Canvas(3 * 256, 3 * 192, TEXEL / 3, seed=3)
    grain = Spectrum(coarse=0.1, fine=0.03, stretch=3.0, angle=angle)
    coarse_noise, fine_noise = noise(CANVAS, "a", grain), noise(fine, "a", grain)
    np.testing.assert_allclose(fine_noise[1::3, 1::3], coarse_noise, atol=1e-9)
    coarse_cells = cells(CANVAS, "c", 0.05, angle=angle, stretch=2.0)
    fine_cells = cells(fine, "c", 0.05, angle=angle, stretch=2.0)
    np.testing.assert_allclose(fine_cells.nearest[1::3, 1::3], coarse_cells.nearest, atol=1e-9)


def test_labels_and_seeds_are_independent():
    first = noise(CANVAS, "a", SPECTRUM)
    for other in (
        noise(CANVAS, "b", SPECTRUM),
        noise(Canvas(256, 192, TEXEL, seed=4), "a", SPECTRUM),
    ):
        assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 0.2


def test_grain_runs_along_its_angle():
    """Stretched along x, neighbours along x are more alike than neighbours along y."""
    field = noise(CANVAS, "a", Spectrum(0.1, 0.03, stretch=5.0, angle=0.0))
    assert np.diff(field, axis=1).std() < 0.5 * np.diff(field, axis=0).std()
    upright = noise(CANVAS, "a", Spectrum(0.1, 0.03, stretch=5.0, angle=math.pi / 2))
    assert np.diff(upright, axis=0).std() < 0.5 * np.diff(upright, axis=1).std()


def test_nearest_cell_is_the_nearest():
    """Against every point by brute force; the search looks at nine squares only."""
    found = cells(CANVAS, "c", 0.1, jitter=0.8)
    points = np.array(
        [
            [
                (c + 0.5) * TEXEL - found.offset[0][r, c] * 0.1,
                (r + 0.5) * TEXEL - found.offset[1][r, c] * 0.1,
            ]
            for r in range(0, 192, 2)
            for c in range(0, 256, 2)
        ]
    )
    points = np.unique(points.round(9), axis=0)
    x, y = np.broadcast_arrays(CANVAS.x, CANVAS.y)
    distance = np.hypot(x[..., None] - points[:, 0], y[..., None] - points[:, 1]).min(axis=-1)
    inner = (slice(16, -16), slice(16, -16))
    np.testing.assert_allclose(found.nearest[inner] * 0.1, distance[inner], atol=1e-8)
    assert (found.second >= found.nearest).all()


@pytest.mark.parametrize("over", [1, 2, 3])
def test_weave_alternates(over):
    u, v = np.meshgrid(np.arange(12) + 6.5, np.arange(12) + 6.5)
    threads = weave(u, v, over=over)
    column, row = threads.column, threads.row
    np.testing.assert_array_equal(threads.warp_on_top, (column + row) % (2 * over) < over)
