"""Heights at another resolution keep the mean slopes that the normals of a map set show."""

import cv2
import numpy as np
import pytest

from matcap.brdf.heights import resized_height, with_slopes_of_means

INSIDE = slice(8, -8)  # of a border, where central differences are one-sided


def waves(period, angle, side=480):
    """(side, side) heights, of a wavelength in texels."""
    y, x = np.mgrid[:side, :side]
    along = np.cos(angle) * x + np.sin(angle) * y
    return np.cos(2.0 * np.pi * along / period + 0.3).astype(np.float32)


def slopes(heights):
    return np.stack(np.gradient(heights))


def means(planes, side):
    return np.stack([cv2.resize(p, (side, side), interpolation=cv2.INTER_AREA) for p in planes])


def energy(planes):
    return float(np.square(planes[:, INSIDE, INSIDE]).mean())


@pytest.mark.parametrize("angle", [0.0, 0.5, np.pi / 4.0])
@pytest.mark.parametrize("period", [4.0, 5.0, 8.0, 20.0])
def test_halved_heights_have_the_energy_of_the_mean_slopes(period, angle):
    fine = waves(2.0 * period, angle)
    halved = slopes(resized_height(fine, (240, 240))) / 2.0
    wanted = means(slopes(fine), 240)
    assert energy(halved) == pytest.approx(energy(wanted), rel=0.05)
    averaged = slopes(cv2.resize(fine, (240, 240), interpolation=cv2.INTER_AREA)) / 2.0
    assert energy(averaged) < energy(halved)
    if period == 4.0 and angle == 0.0:
        assert energy(averaged) < 0.55 * energy(wanted)


@pytest.mark.parametrize("times", [2, 3])
@pytest.mark.parametrize("period", [4.0, 6.0, 16.0])
def test_enlarged_heights_have_the_slopes_of_their_waves(period, times):
    fine = slopes(resized_height(waves(period, 0.0, 120), (120 * times, 120 * times)))
    at = (np.arange(120 * times) + 0.5) / times - 0.5
    turn = 2.0 * np.pi / period
    true = np.broadcast_to(-turn * np.sin(turn * at + 0.3) / times, fine[0].shape)
    assert energy(fine - np.stack([0.0 * true, true])) < 0.03 * energy(true[None])


@pytest.mark.parametrize("place", range(60, 64))
def test_slopes_of_a_step_hardly_ring(place):
    step = np.zeros((48, 128), np.float32)
    step[:, place:] = 1.0
    small = resized_height(step, (64, 24))
    across = np.gradient(small[12]) / 2.0
    largest = np.gradient(step[0]).max()
    assert across.min() > -0.12 * largest and across.max() < 1.12 * largest
    assert small.min() > -0.4 and small.max() < 1.4


def test_ramps_stay_ramps():
    y, x = np.mgrid[:96, :128].astype(np.float32)
    small = resized_height(0.3 * x - 0.2 * y, (64, 48))
    down, across = np.gradient(small)
    assert across == pytest.approx(0.6, abs=1e-4) and down == pytest.approx(-0.4, abs=1e-4)


def test_white_noise_does_not_grow():
    """What central differences do not show, waves of two texels, is as in the area mean."""
    noise = np.random.default_rng(1).standard_normal((256, 256)).astype(np.float32)
    small = resized_height(noise, (128, 128))
    mean = cv2.resize(noise, (128, 128), interpolation=cv2.INTER_AREA)
    assert small.std() < 1.6 * mean.std()


@pytest.mark.parametrize("angle", [0.0, 0.5])
@pytest.mark.parametrize(("period", "least"), [(4.0, 0.66), (6.0, 0.9), (12.0, 0.98)])
def test_means_of_heights_get_slopes_nearer_to_those_of_their_surface(period, least, angle):
    fine = waves(4.0 * period, angle)
    (mean,) = means([fine], 120)
    wanted = energy(means(4.0 * slopes(fine), 120))
    raised = with_slopes_of_means(mean)
    assert max(least, energy(slopes(mean)) / wanted) < energy(slopes(raised)) / wanted < 1.01


def test_ramps_are_not_raised():
    y, x = np.mgrid[:81, :120].astype(np.float32)
    ramp = 0.3 * x - 0.2 * y
    assert with_slopes_of_means(ramp)[INSIDE, INSIDE] == pytest.approx(
        ramp[INSIDE, INSIDE], abs=1e-3
    )
