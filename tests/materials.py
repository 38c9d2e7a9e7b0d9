"""Small materials, of the shape that captures have; as fixtures, too."""

from dataclasses import replace

import pytest
import torch

from matcap.field.field import read_source
from matcap.field.material import Material
from matcap.field.plane import Grid, Rectangle
from matcap.flash.geometry import FlashSetup
from matcap.space.decoder import CODE_SIZE, DRAWING_CHANNELS, Decoder, DecoderConfig
from matcap.space.freeze import freeze
from matcap.space.tuned import TunedDecoder
from matcap.statistics.lattice import Wave

TINY = DecoderConfig(noise_channels=2, widths=(2, 3, 3, 3, 3), convolutions=(1, 1))
SMALL = DecoderConfig(noise_channels=4, widths=(4, 6, 6, 6, 6))


def a_material(
    name="tiny",
    seed=3,
    config=TINY,
    waves=(),
    example=None,
    drawing=None,
    across=1024,
    provenance=None,
):
    """Random weights; codes of different seeds look different. Perhaps an exemplar beside them."""
    config = replace(config, drawing=0 if drawing is None else DRAWING_CHANNELS)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        decoder = Decoder(config).eval().requires_grad_(False)
        for layer in decoder.layers():
            layer.adain.affine.bias.data += 0.2 * torch.randn_like(layer.adain.affine.bias)
    code = torch.zeros(CODE_SIZE)
    moments = tuple(freeze(decoder, code, waves, drawing))
    tuned = TunedDecoder(decoder, code, moments, waves, 2 / across, drawing)
    made = {"decoder": tuned} if example is None else {"example": example, "decoder": tuned}
    return Material(name, made, 2 / across, FlashSetup(), provenance or {})


def quick_maps(material, width, height, *, seed=0, x=0, y=0, period=None):
    """Material.maps() of a decoder, by blocks smaller than the shipped ones, to take less time."""
    source = replace(material.generator.source(seed, period), grid=Grid(128, 64))
    return read_source(source, Rectangle(x, y, width, height), 1)


@pytest.fixture(scope="session")
def material():
    return a_material()


@pytest.fixture(scope="session")
def wavy():
    return a_material("wavy", waves=(Wave(1 / 16.7, 0.003), Wave(0.002, 1 / 9.3)))


@pytest.fixture(scope="session")
def make_material():
    """For materials of other shapes."""
    return a_material
