"""What photographs tell of each octave, by made photographs whose noise is known."""

import cv2
import numpy as np
import pytest

from matcap.capture.multiview.octaves import denoised, prediction_error

SIZE = (192, 256)
PHOTOGRAPHS = 5


def _waves(seed, deviation):
    """(H, W) of deviation 1, smooth over some texels."""
    noise = np.random.default_rng(seed).normal(size=SIZE)
    found = cv2.GaussianBlur(noise, (0, 0), deviation) if deviation else noise
    return np.asarray(found / found.std(), np.float32)


def _estimate(true, noise):
    """What photographs tell that are off by noise each, and what it changes without each."""
    every = np.stack([true + noise * _waves(10 + k, 0.0) for k in range(PHOTOGRAPHS)])
    result = every.mean(0)
    others = (PHOTOGRAPHS * result - every) / (PHOTOGRAPHS - 1)
    return result, list(others - result), every[0]


def _energy(found):
    return float(np.square(found).mean())


def test_noise_goes_and_strength_stays():
    true = _waves(0, 6.0)
    result, changes, _ = _estimate(true, 2.0)
    found = denoised(result, np.zeros_like(true), changes)
    assert _energy(result - true) > 0.7
    assert _energy(found - true) < 0.1
    assert _energy(found) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("strength", [0.3, 1.0, 3.0])
def test_what_was_read_is_calibrated_whatever_its_strength(strength):
    true = _waves(1, 3.0)
    result, changes, _ = _estimate(true, 0.5)
    found = denoised(result, strength * true, changes)
    assert _energy(found) == pytest.approx(1.0, abs=0.07)
    assert _energy(found - true) < 0.03
    # What was read too strong holds nothing back.
    weak = max(1.0 - strength, 0.0) ** 2
    assert prediction_error(result, strength * true, changes)[0] == pytest.approx(
        weak, rel=0.15, abs=0.02
    )


def test_what_is_flat_stays_flat():
    result, changes, _ = _estimate(np.zeros(SIZE, np.float32), 0.5)
    nothing = np.zeros(SIZE, np.float32)
    assert _energy(denoised(result, nothing, changes)) < 0.1 * _energy(result)
    assert prediction_error(result, nothing, changes)[0] < 0.1 * _energy(result)


def test_noise_of_the_first_photograph_is_not_taken_for_what_was_read():
    true = _waves(2, 6.0)
    result, changes, first = _estimate(true, 1.0)
    found = denoised(result, first, changes)
    assert _energy(found - true) < 0.3 * _energy(result - true)


def test_what_noise_hides_is_drawn_as_it_was_read():
    true, fine = _waves(3, 6.0), 0.3 * _waves(4, 0.0)
    result, changes, _ = _estimate(true, 2.0)
    plain, drawn = (denoised(result, true + fine, changes, keep_energy=d) for d in (False, True))
    assert _energy(drawn) > _energy(plain) + 0.2 * _energy(fine)
    assert _energy(drawn) < 1.0 + 2.0 * _energy(fine)
