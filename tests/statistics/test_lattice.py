"""Spectra and lattices."""

import math

import pytest
import torch

from matcap.statistics.lattice import autocorrelation, find_lattice, power_spectrum

# Plane waves put into a picture come out of it; noise has none.

SIZE = 384
# Cycles per texel by which a found wave may miss: a twentieth of a bin of 1/256, so that over the
# 384 texels of the picture its phase drifts by less than a tenth of a turn.
MISS = 0.05 / 256


def wave(fx, fy, sharpness=1.0):
    rows, columns = torch.meshgrid(torch.arange(SIZE), torch.arange(SIZE), indexing="ij")
    turns = 2.0 * math.pi * (fx * columns + fy * rows)
    return torch.tanh(sharpness * torch.cos(turns)) / math.tanh(sharpness)


def noise(seed=0):
    return torch.randn(3, SIZE, SIZE, generator=torch.Generator().manual_seed(seed))


ALL = torch.ones(SIZE, SIZE, dtype=torch.bool)


def generates(found, wanted):
    """How far `wanted` lies from the nearest lattice point of the waves found."""
    orders = range(-3, 4)
    points = [(0.0, 0.0)]
    for w in found:
        points = [(x + n * w.fx, y + n * w.fy) for x, y in points for n in orders]
    return min(math.hypot(x - wanted[0], y - wanted[1]) for x, y in points)


@pytest.mark.parametrize(
    ("fx", "fy"), [(1 / 16.7, 0.0), (0.0, 1 / 9.3), (0.05, 0.021), (0.043, -0.06)]
)
def test_stripes_have_one_frequency_vector(fx, fy):
    lattice = find_lattice(wave(fx, fy) + 0.5 * noise(), ALL)
    (found,) = lattice.waves
    sign = 1.0 if found.fx * fx + found.fy * fy > 0 else -1.0
    assert math.hypot(found.fx - sign * fx, found.fy - sign * fy) < MISS and lattice.share > 0.3


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.1])
def test_a_weave_has_two_frequency_vectors_that_generate_its_lattice(turn):
    c, s = math.cos(turn), math.sin(turn)
    first, second = (c / 17.3, s / 17.3), (-s / 12.9, c / 12.9)
    weave = wave(*first, sharpness=3.0) + wave(*second, sharpness=3.0)
    lattice = find_lattice(weave + 0.5 * noise(), ALL)
    assert len(lattice.waves) == 2
    for wanted in (first, second):
        assert generates(lattice.waves, wanted) < MISS


@pytest.mark.parametrize("seed", range(2))
def test_fine_and_coarse_noise_have_no_lattice(seed):
    assert find_lattice(noise(seed), ALL).waves == ()
    coarse = torch.nn.functional.avg_pool2d(noise(seed)[None], 9, 1, 4)[0]
    assert find_lattice(coarse, ALL).waves == ()


def test_clipped_texels_do_not_change_the_lattice():
    valid = ALL.clone()
    valid[:, 260:] = False
    picture = noise()
    picture[:, :, 260:] += 5.0 * wave(0.0, 1 / 10)[:, 260:]
    assert find_lattice(picture, valid).waves == ()


def test_a_picture_smaller_than_a_window_has_no_lattice():
    assert find_lattice(wave(0.1, 0.0)[None, :200, :200].expand(3, -1, -1), ALL).waves == ()


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_a_constant_or_unseen_picture_has_no_lattice(value):
    flat = torch.full((3, SIZE, SIZE), value)
    assert find_lattice(flat, ALL).waves == () and find_lattice(noise(), ~ALL).waves == ()


@pytest.mark.parametrize(("along_x", "along_y"), [(72.0, 87.0), (40.0, 110.0), (31.0, 24.0)])
def test_a_check_has_the_periods_of_all_its_stripes(along_x, along_y):
    """Three stripes to a period, one of another colour: the third harmonic is the strongest."""
    rows, columns = torch.meshgrid(torch.arange(560), torch.arange(640), indexing="ij")

    def stripes(places, period):
        turn = places / period % 1.0
        return torch.tanh(4.0 * torch.cos(2 * math.pi * 3 * turn)) * (1.0 - 0.7 * (turn < 1 / 3))

    check = stripes(columns, along_x)[None] + stripes(rows, along_y)[None]
    picture = check.repeat(3, 1, 1) + 0.4 * torch.randn(
        3, 560, 640, generator=torch.Generator().manual_seed(1)
    )
    lattice = find_lattice(picture, torch.ones(560, 640, dtype=torch.bool))
    assert len(lattice.waves) == 2
    for wanted in ((1 / along_x, 0.0), (0.0, 1 / along_y)):
        assert generates(lattice.waves, wanted) < MISS
    # And no finer than that: the cell is one period of the check.
    (ax, ay), (bx, by) = ((w.fx, w.fy) for w in lattice.waves)
    assert abs(ax * by - ay * bx) * along_x * along_y == pytest.approx(1.0, rel=0.02)


# Power spectra and autocorrelations against closed forms and plain sums.


def spectrum_noise(*shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(shape, generator=generator, dtype=torch.float64)


def cosine(size, fx, fy, phase=0.3):
    rows, columns = torch.meshgrid(*[torch.arange(size, dtype=torch.float64)] * 2, indexing="ij")
    turns = (fx * columns + fy * rows) / size
    return torch.cos(2.0 * math.pi * turns + phase)[None, None]


def test_white_noise_has_unit_power_everywhere():
    power = power_spectrum(spectrum_noise(200, 1, 16, 24)).mean(0)[0]
    middle = power[2:-2, 2:-1]  # away from zero frequency, where the mean was taken off
    assert (middle - 1.0).abs().max() < 0.4  # deviation 1 / sqrt(200) each
    assert float(middle.mean()) == pytest.approx(1.0, abs=0.03)


def test_a_cosine_peaks_at_its_frequency():
    power = power_spectrum(cosine(32, 5, -3))[0, 0]
    row, column = divmod(int(power.argmax()), power.shape[1])
    assert (row, column) == (32 - 3, 5)
    far = power.clone()
    far[-5:-1, 3:8] = 0.0
    assert far.max() < 1e-12 * power.max()  # a Hann window leaks two bins and no further


@pytest.mark.parametrize("size", [(12, 16), (13, 9)])
def test_autocorrelation_is_the_plain_sum_over_lags(size):
    image, reach = spectrum_noise(1, 2, *size), 3
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
    assert torch.autograd.gradcheck(statistic, (spectrum_noise(1, 1, 6, 8).requires_grad_(),))
