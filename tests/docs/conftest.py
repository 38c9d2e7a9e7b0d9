"""A small material, to run what the pages show with."""

import pytest
import torch

from matcap.flash.geometry import FlashSetup
from matcap.space.decoder import CODE_SIZE, Decoder, DecoderConfig
from matcap.space.freeze import freeze
from matcap.space.tuned import TunedDecoder

SMALL = DecoderConfig(noise_channels=4, widths=(4, 6, 6, 6, 6))


@pytest.fixture(scope="session")
def small():
    """An untrained material of the right form."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(3)
        decoder = Decoder(SMALL)
    code = torch.zeros(CODE_SIZE)
    moments = tuple(freeze(decoder, code, ()))
    return TunedDecoder(decoder, code, moments, (), 2 / 256).material("leather", FlashSetup())
