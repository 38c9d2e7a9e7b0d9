"""Decoder, field and encoder: far away, with extreme weights, in bfloat16, frozen or not."""

import pytest
import torch
from plain_decoder import decoded

from matcap.field.field import Field
from matcap.field.plane import COORDINATE_LIMIT, Rectangle
from matcap.flash.alignment import PICTURE_CHANNELS
from matcap.flash.geometry import FlashSetup
from matcap.space.decoder import ALIGNMENT, CODE_SIZE, DEPTH, Decoder, DecoderConfig, maps_from_raw
from matcap.space.encoder import NUMBERS, TEXTURE, Encoder, EncoderConfig
from matcap.space.freeze import fold, freeze
from matcap.space.random_field import Patch, random_field
from matcap.space.tuned import TunedDecoder
from matcap.statistics.lattice import Wave

CONFIG = DecoderConfig(noise_channels=4, widths=(8, 8, 8, 8, 8))
WAVES = (Wave(1 / 16.7, 0.003), Wave(0.002, 1 / 9.3))
CODE = torch.randn(CODE_SIZE, generator=torch.Generator().manual_seed(2))


def a_decoder(gain=1.0):
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(3)
        decoder = Decoder(CONFIG)
    with torch.no_grad():
        for parameter in decoder.parameters():
            parameter.mul_(gain)
    return decoder


def a_field(size=64):
    patch = Patch(0, Rectangle(0, 0, size, size))
    return random_field(patch, CONFIG.noise_channels, WAVES, levels=DEPTH)


def a_material(decoder):
    moments = tuple(freeze(decoder, CODE, WAVES))
    return TunedDecoder(decoder, CODE, moments, WAVES, 2 / 1024).material("test", FlashSetup())


def finite(*tensors):
    return all(bool(torch.isfinite(tensor).all()) for tensor in tensors)


@pytest.mark.parametrize("half_precision", [False, True])
@pytest.mark.parametrize("frozen", [False, True])
@pytest.mark.parametrize("gain", [0.0, 1e-12, 1e-3, 1.0, 30.0])
def test_weights_of_any_size_give_finite_maps_and_gradients(gain, frozen, half_precision):
    decoder = a_decoder(gain)
    moments = freeze(decoder, CODE, WAVES) if frozen else None
    with torch.autocast("cpu", torch.bfloat16, enabled=half_precision):
        raw = decoder(a_field(), CODE, moments)
    maps = maps_from_raw(raw, 2 / 1024, periodic=True)
    (maps.stacked().sum() + maps.normal.sum()).backward()
    assert finite(maps.stacked(), maps.normal)
    assert finite(*(p.grad for p in decoder.parameters()))


@pytest.mark.parametrize("sign", [-1, 1])
def test_the_farthest_texels_are_like_the_nearest(sign):
    """Finite, and of the same distribution: neither phases nor hashes wear out."""
    field = Field(a_material(a_decoder()), seed=sign * (2**63 - 1))
    end = COORDINATE_LIMIT - 200 if sign > 0 else -COORDINATE_LIMIT
    far, near = field.read(end, end, 200, 200).stacked(), field.read(0, 0, 200, 200).stacked()
    assert finite(far)
    spread = near.std((1, 2))
    assert ((far.mean((1, 2)) - near.mean((1, 2))).abs() < 0.3 * spread).all()
    assert torch.allclose(far.std((1, 2)), spread, rtol=0.2)


def test_bfloat16_is_float32_to_two_digits():
    decoder, field = a_decoder(), a_field(128)
    with torch.no_grad():
        exact = decoder(field, CODE)
        with torch.autocast("cpu", torch.bfloat16):
            rough = decoder(field, CODE)
    assert rough.dtype == torch.float32
    error = (rough - exact).square().mean((0, 2, 3)).sqrt() / exact.std((0, 2, 3))
    assert error.max() < 0.05


def test_folding_changes_nothing_whatever_the_weights():
    for gain in (1e-3, 1.0, 30.0):
        decoder = a_decoder(gain)
        moments = freeze(decoder, CODE, WAVES)
        folded = fold(decoder, CODE, moments, has_waves=True)
        with torch.no_grad():
            one = decoded(folded, a_field(256))[..., 96:-96, 96:-96]
            other = decoder(a_field(256), CODE, moments, periodic=False)[..., 96:-96, 96:-96]
        assert torch.allclose(one, other, atol=1e-4 * float(other.abs().max().clamp_min(1.0)))


@pytest.mark.usefixtures("two_threads")
def test_the_number_of_threads_changes_a_decoded_window_by_rounding_alone():
    decoder = a_decoder()
    with torch.no_grad():
        two = decoder(a_field(ALIGNMENT * 8), CODE)
        torch.set_num_threads(1)
        one = decoder(a_field(ALIGNMENT * 8), CODE)
    assert torch.allclose(one, two, atol=1e-4)


@pytest.mark.parametrize("gain", [0.0, 1.0, 1e4, -1e4])
def test_kl_is_finite_however_sure_or_unsure_the_encoder_is(gain):
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(1)
        encoder = Encoder(EncoderConfig(width=64))
    last = [m for m in encoder.head.modules() if isinstance(m, torch.nn.Linear)][-1]
    with torch.no_grad():
        last.bias[CODE_SIZE:] = gain
    mean, log_variance = encoder(
        torch.zeros(1, PICTURE_CHANNELS, 48, 64), torch.zeros(1, NUMBERS), torch.zeros(1, TEXTURE)
    )
    kl = 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).mean()
    code = mean + torch.exp(0.5 * log_variance)
    (kl + code.sum()).backward()
    assert finite(kl, code, *(p.grad for p in encoder.parameters() if p.grad is not None))
    assert float(kl.detach()) < 1e4
