"""Relief averaged over the cells of a lattice."""

import cv2
import numpy as np
import pytest

from matcap.capture.exemplar.lattice_relief import averaged_over_cells
from matcap.capture.exemplar.relief_spectrum import slope_energies

SIDE, PERIOD = 320, 12.0
WAVES = ((1.0 / PERIOD, 0.01), (-0.01, 1.0 / PERIOD))
Y, X = np.mgrid[:SIDE, :SIDE].astype(np.float32)


def clouds(seed, deviation):
    """(SIDE, SIDE) smooth noise of unit deviation."""
    noise = np.random.default_rng(seed).standard_normal((SIDE, SIDE)).astype(np.float32)
    plane = cv2.GaussianBlur(noise, (0, 0), deviation)
    return plane / plane.std()


def woven(wander=1.0):
    """Two heights, of the threads along x and along y, which wander by some texels."""
    x, y = (plane + wander * clouds(seed, 30.0) for seed, plane in ((1, X), (2, Y)))
    one, other = (2.0 * np.pi * (fx * x + fy * y) for fx, fy in WAVES)
    return 0.6 * np.cos(one) + 0.2 * np.sin(2.0 * one), 0.5 * np.sin(other)


def photographed(threads):
    """Log radiance of threads lit from above the middle, and the height that is predicted of it.

    Slopes across the flash's direction, and all at the mirror point, do not show.
    """
    towards = [plane / (0.5 * SIDE) - 1.0 for plane in (X, Y)]
    down, right = np.gradient(sum(threads))
    log = towards[0] * right + towards[1] * down
    seen = (1.0 - np.exp(-8.0 * light * light) for light in towards)
    return log, sum(share * part for share, part in zip(seen, threads, strict=True))


def alike(height, true):
    """Correlation of slopes."""
    slopes = (np.stack(np.gradient(plane)).ravel() for plane in (height, true))
    return float(np.corrcoef(*slopes)[0, 1])


def test_the_mean_cell_errs_less_than_each_of_them():
    """Each of 27 x 27 cells lacks another part, which the flash does not show there."""
    threads = woven()
    true, (log, predicted) = sum(threads), photographed(threads)
    mean = averaged_over_cells(predicted, log, WAVES)
    assert alike(predicted, true) < 0.9
    assert alike(mean, true) > 0.96
    assert slope_energies(mean).sum() == pytest.approx(slope_energies(predicted).sum(), rel=0.05)


@pytest.mark.parametrize("waves", [(), WAVES[:1]])
def test_relief_without_two_waves_is_left_alone(waves):
    log, predicted = photographed(woven())
    assert averaged_over_cells(predicted, log, waves) is predicted


def test_relief_that_is_no_lattice_is_left_alone():
    """The picture alone is regular, such as a printed pattern on leather."""
    log, _ = photographed(woven())
    relief = 2.0 * clouds(3, 2.0)
    assert averaged_over_cells(relief, log, WAVES) is relief


def test_mostly_irregular_relief_is_left_alone():
    """A cloth whose threads differ from each other keeps them."""
    log, predicted = photographed(woven())
    bumps = clouds(4, 1.5)
    share = slope_energies(bumps).sum() / slope_energies(predicted).sum()
    mixed = predicted + bumps * np.float32(np.sqrt(2.0 / share))
    assert averaged_over_cells(mixed, log, WAVES) is mixed
