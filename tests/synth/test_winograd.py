"""Wide networks by Winograd's convolutions: the same maps, the same bits however they are read."""

import pytest
import torch
from draws import run

from matcap.model import winograd
from matcap.model.convolve import CHANNELS_LAST
from matcap.model.decoder import PAPER_CONFIG, DecoderConfig
from matcap.model.plane import Rectangle
from matcap.model.source import material_source
from matcap.model.winograd import WINOGRAD
from matcap.statistics.lattice import Wave

WIDE = DecoderConfig(noise_channels=2, widths=(32, 32, 32, 32, 32), convolutions=(1, 1))
BLOCK = Rectangle(512, -256, 128, 64)
pytestmark = pytest.mark.skipif(not winograd.available(), reason="PyTorch has no NNPACK here")


@pytest.fixture(scope="module", params=[(), (Wave(1 / 16.7, 0.003),)], ids=["noise", "wave"])
def wide(make_material, request):
    return make_material("wide", config=WIDE, waves=request.param)


def test_wide_networks_have_these_steps_and_no_others(material, wide, make_material, monkeypatch):
    decoder = wide.folded()
    assert decoder.steps is WINOGRAD
    assert make_material(config=PAPER_CONFIG).folded().steps is WINOGRAD
    assert make_material(config=DecoderConfig()).folded().steps is CHANNELS_LAST
    assert material.folded().steps is CHANNELS_LAST
    for finest in range(3):
        assert decoder.lowered(finest).steps is CHANNELS_LAST
    assert decoder.to(torch.device("meta")).steps is CHANNELS_LAST
    monkeypatch.setattr(winograd, "available", lambda: False)
    assert decoder.steps is CHANNELS_LAST


def test_the_maps_are_those_of_the_plain_steps(wide, monkeypatch):
    """Within a twentieth of an 8-bit step; heights as parts of their range."""
    source = material_source(wide, 1)
    found = source.maps(BLOCK)
    monkeypatch.setattr(winograd, "available", lambda: False)
    expected = source.maps(BLOCK)
    assert not torch.equal(found, expected)
    assert float((found - expected)[:5].abs().max()) < 0.05 / 255
    height = expected[5]
    assert float((found[5] - height).abs().max()) < 0.05 / 255 * float(height.max() - height.min())


def test_random_rectangles_orders_and_workers_give_the_same_bits(wide):
    assert run(wide, 9) == 9


def test_halving_is_max_pooling():
    features = torch.randn(1, 3, 10, 14)
    assert torch.equal(WINOGRAD.halve(features), CHANNELS_LAST.halve(features))
