"""Curves, logarithms, roots, normalisations and statistics where they are steepest or undefined."""

import math

import pytest
import torch

from matcap.space.decoder import CODE_SIZE, Decoder, DecoderConfig
from matcap.space.tuning.match import log_contrast
from matcap.statistics.compare import (
    Encoding,
    FilterBank,
    FilterBankConfig,
    Weights,
    describe,
    distance,
    fit_encoding,
    gram,
)
from matcap.statistics.lattice import autocorrelation, find_lattice, power_spectrum

BANK = FilterBank(FilterBankConfig(sizes=(5,), filters=8, levels=3))
SIDE = 64


def one_hot(value):
    window = torch.zeros(1, 3, SIDE, SIDE)
    window[..., 20, 30] = value
    return window


def checkerboard():
    rows, columns = torch.meshgrid(torch.arange(SIDE), torch.arange(SIDE), indexing="ij")
    return (0.1 + 0.8 * ((rows + columns) % 2)).float().expand(1, 3, -1, -1).clone()


NOISE = torch.rand(1, 3, SIDE, SIDE, generator=torch.Generator().manual_seed(0))
WINDOWS = {
    "black": torch.zeros(1, 3, SIDE, SIDE),
    "white": torch.ones(1, 3, SIDE, SIDE),
    "grey": torch.full((1, 3, SIDE, SIDE), 0.2),
    "denormal": torch.full((1, 3, SIDE, SIDE), 1e-42),
    "one hot": one_hot(1.0),
    "one huge": one_hot(1e30),
    "huge": 1e18 * NOISE,
    "noise": NOISE,
    "faint noise": 0.2 + 1e-7 * NOISE,
    "checkerboard": checkerboard(),
    "red alone": NOISE * torch.tensor([1.0, 0.0, 0.0])[:, None, None],
}
ALL = torch.ones(SIDE, SIDE, dtype=torch.bool)
DTYPES = [torch.float32, torch.bfloat16]


def finite(*tensors):
    return all(bool(torch.isfinite(tensor).all()) for tensor in tensors)


@pytest.mark.parametrize("half_precision", [False, True])
@pytest.mark.parametrize("target", WINDOWS)
def test_any_window_is_compared_with_any_photographs(target, half_precision):
    """Loss and gradient, with the encoding fitted to the hard window itself."""
    encoding = fit_encoding(WINDOWS[target][0], ALL)
    assert finite(encoding.matrix) and encoding.median > 0
    wanted = describe(WINDOWS[target], encoding, BANK)
    for name, window in WINDOWS.items():
        rendered = window.clone().requires_grad_()
        with torch.autocast("cpu", torch.bfloat16, enabled=half_precision):
            found = describe(rendered, encoding, BANK)
        loss = distance(found, wanted, Weights()).sum()
        loss.backward()
        assert finite(loss, rendered.grad), name
        # A finite step of any optimiser stays finite, too.
        assert rendered.grad.abs().max() < 1e12, name


@pytest.mark.parametrize("name", WINDOWS)
def test_an_encoding_is_found_however_little_was_seen(name):
    window = WINDOWS[name][0]
    for valid in (ALL, ~ALL, one_hot(1.0)[0, 0] > 0):
        encoding = fit_encoding(window, valid)
        assert finite(encoding.matrix, encoding(window[None]), log_contrast(window, valid))


@pytest.mark.parametrize("dtype", [*DTYPES, torch.float64])
@pytest.mark.parametrize("name", [n for n in WINDOWS if n not in ("huge", "one huge")])
def test_gram_matrices_and_their_gradients_are_finite(name, dtype):
    window = WINDOWS[name].to(dtype, copy=True).requires_grad_()
    found = gram(BANK.features(window))
    found.sum().backward()
    assert finite(found, window.grad)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("name", [n for n in WINDOWS if n not in ("huge", "one huge")])
def test_spectra_and_their_gradients_are_finite(name, dtype):
    for statistic in (power_spectrum, lambda w: autocorrelation(w, 5)):
        window = WINDOWS[name].to(dtype, copy=True).requires_grad_()
        found = statistic(window)
        found.sum().backward()
        assert finite(found, window.grad)
        if name in ("black", "white", "grey"):
            assert found.abs().max() < 1e-10


@pytest.mark.parametrize("name", WINDOWS)
def test_no_order_is_invented(name):
    """Tiled to the size that is looked at; only true order may be found, and it is finite."""
    picture = fit_encoding(WINDOWS[name][0], ALL)(WINDOWS[name])[0].repeat(1, 4, 4)
    lattice = find_lattice(picture, torch.ones(256, 256, dtype=torch.bool))
    assert all(math.isfinite(w.fx) and math.isfinite(w.fy) for w in lattice.waves)
    if name in ("black", "white", "grey", "denormal"):
        assert lattice.waves == ()


@pytest.mark.parametrize("value", [0.0, 1e-45, 1e-30, 1e-6, 1.0, 2.0, 1e30])
def test_the_logarithm_of_light_has_a_bounded_slope(value):
    encoding = Encoding(0.1, torch.eye(3))
    light = torch.full((1, 3, 1, 1), value, requires_grad=True)
    log = encoding.log(light)
    log.sum().backward()
    assert finite(log, light.grad)
    assert 0.0 <= float(light.grad.max()) <= 1.0 / (0.1 * 0.05) * 1.001


CONSTANTS = [0.0, 1.0, -3.0, 1e4]


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("value", CONSTANTS)
def test_adain_on_constant_features_gives_the_codes_own_mean(value, dtype):
    """And a gradient that is finite: the deviation is 0, not its root's slope."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        layer = Decoder(DecoderConfig(4, (4, 4, 4, 4, 4))).layers()[0]
    code = torch.randn(CODE_SIZE, generator=torch.Generator().manual_seed(1))
    features = torch.full((1, 4, 8, 8), value, dtype=dtype).requires_grad_()
    _, moments = layer.adain.measured(features.detach(), code)
    adapted = layer.adain(features, code, moments)
    adapted.float().square().sum().backward()
    assert finite(adapted, features.grad, *(p.grad for p in layer.adain.parameters()))
    if dtype == torch.float32:
        wanted = layer.adain.target(code)[0]
        assert torch.allclose(adapted.mean((2, 3))[0], wanted, atol=1e-3 + 1e-4 * abs(value))


def test_faint_statistics_are_not_what_errors_are_measured_by():
    """A plain photograph's autocorrelation is 0: a capture's error was 1e14 times a texture's."""
    encoding = fit_encoding(WINDOWS["grey"][0], ALL)
    target = describe(WINDOWS["grey"], encoding, BANK)
    near = describe(0.2 + 0.002 * (NOISE - 0.5), encoding, BANK)
    assert float(distance(near, target, Weights())) < 1000.0
