"""Power spectra and autocorrelations against closed forms and plain sums."""

import math

import pytest
import torch

from matcap.statistics.spectrum import autocorrelation, power_spectrum


def noise(*shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(shape, generator=generator, dtype=torch.float64)


def cosine(size, fx, fy, phase=0.3):
    rows, columns = torch.meshgrid(*[torch.arange(size, dtype=torch.float64)] * 2, indexing="ij")
    turns = (fx * columns + fy * rows) / size
    return torch.cos(2.0 * math.pi * turns + phase)[None, None]


def test_white_noise_has_unit_power_everywhere():
    power = power_spectrum(noise(200, 1, 16, 24)).mean(0)[0]
    middle = power[2:-2, 2:-1]  # away from zero frequency, where the mean was taken off
    assert (middle - 1.0).abs().max() < 0.4  # deviation 1 / sqrt(200) each
    assert float(middle.mean()) == pytest.approx(1.0, abs=0.03)


def test_a_cosine_stands_at_its_own_frequency():
    power = power_spectrum(cosine(32, 5, -3))[0, 0]
    row, column = divmod(int(power.argmax()), power.shape[1])
    assert (row, column) == (32 - 3, 5)
    far = power.clone()
    far[-5:-1, 3:8] = 0.0
    assert far.max() < 1e-12 * power.max()  # a Hann window leaks two bins and no further


@pytest.mark.parametrize("size", [(12, 16), (13, 9)])
def test_autocorrelation_is_the_plain_sum_over_lags(size):
    image, reach = noise(1, 2, *size), 3
    hann = [torch.hann_window(s, periodic=True, dtype=torch.float64) for s in size]
    window = hann[0][:, None] * hann[1]
    centred = (image - image.mean((2, 3), keepdim=True)) * window
    found = autocorrelation(image, reach)
    assert found.shape == (1, 2, reach + 1, 2 * reach + 1)
    for row in range(reach + 1):
        for column in range(-reach, reach + 1):
            moved = torch.roll(centred, (-row, -column), (2, 3))
            expected = (centred * moved).sum((2, 3)) / window.square().sum()
            assert torch.allclose(found[..., row, reach + column], expected, atol=1e-12)


@pytest.mark.parametrize("statistic", [power_spectrum, lambda i: autocorrelation(i, 2)])
def test_gradients_are_the_derivatives(statistic):
    assert torch.autograd.gradcheck(statistic, (noise(1, 1, 6, 8).requires_grad_(),))
