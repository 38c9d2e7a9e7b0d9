"""AdaIN and the decoder around it: fused forms against the plain formulas."""

import pytest
import torch

from matcap.field.plane import Rectangle
from matcap.space.decoder import CODE_SIZE, DEPTH, AdaIN, Decoder, DecoderConfig
from matcap.space.lattice_channels import WAVE_CHANNELS
from matcap.space.noise import noise_field
from matcap.space.patch import Patch
from matcap.space.random_field import RandomField

TINY = DecoderConfig(noise_channels=2, widths=(4, 4, 4, 4, 4), convolutions=(1, 1))


@pytest.fixture
def features():
    torch.manual_seed(3)
    return 2.0 + 3.0 * torch.randn(2, 5, 16, 24)


@pytest.fixture
def adain():
    torch.manual_seed(4)
    return AdaIN(5)


def test_adain_gives_the_mean_and_deviation_the_code_asks_for(adain, features):
    code = torch.randn(CODE_SIZE)
    mean, deviation = adain.target(code)
    found = adain(features, code, None)
    assert torch.allclose(found.mean((0, 2, 3)), mean, atol=1e-4)
    assert torch.allclose(found.std((0, 2, 3), correction=0), deviation.abs(), atol=1e-4)


def test_adain_with_measured_moments_is_adain(adain, features):
    code = torch.randn(CODE_SIZE)
    adapted, moments = adain.measured(features, code)
    assert torch.allclose(moments[0], features.mean((0, 2, 3)), atol=1e-5)
    assert torch.allclose(moments[1], features.std((0, 2, 3), correction=0), rtol=1e-4)
    assert torch.allclose(adapted, adain(features, code, None), atol=1e-5)
    assert torch.allclose(adain(features, code, moments), adain(features, code, None), atol=1e-5)


def test_adain_of_constant_features_is_finite_with_its_gradient(adain):
    constant = torch.full((1, 5, 8, 8), 7.0, requires_grad=True)
    adain(constant, torch.randn(CODE_SIZE), None).square().sum().backward()
    assert torch.isfinite(constant.grad).all()
    assert torch.isfinite(adain.affine.weight.grad).all()


def test_gradients_of_a_decoder_follow_finite_differences():
    torch.manual_seed(5)
    decoder = Decoder(TINY).double()
    noise = noise_field(Patch(1, Rectangle(0, 0, 32, 32), period=(32, 32)), 2).double()
    waves = tuple(torch.zeros(1, WAVE_CHANNELS, 32 >> n, 32 >> n) for n in range(DEPTH))
    field = RandomField(noise.reshape(1, 2, 32, 32), waves)
    code = torch.randn(CODE_SIZE, dtype=torch.float64)
    weight = decoder.head.adain.affine.bias

    def loss():
        return decoder(field, code).square().mean()

    loss().backward()
    step = 1e-3
    with torch.no_grad():
        for index in (0, 7):
            weight[index] += step
            above = float(loss())
            weight[index] -= 2 * step
            below = float(loss())
            weight[index] += step
            assert float(weight.grad[index]) == pytest.approx((above - below) / 2 / step, rel=1e-2)
