"""Small photographs and a small untrained prior that the tests share."""

import pytest
import torch
from small import SMALL, entry

from matcap.model.alignment import Alignment
from matcap.model.decoder import CODE_SIZE, Decoder
from matcap.model.encoder import Encoder, EncoderConfig
from matcap.prior.base import VARYING, start_head
from matcap.prior.pack import Pack
from matcap.prior.store import Habits, Prior


@pytest.fixture(scope="session")
def pack() -> Pack:
    """Thirteen real materials, so that one is left to train on, and a simulated one."""
    real = [entry(f"m{index}", index) for index in range(13)]
    return Pack((*real, entry("simulated", 99, simulated=True)))


@pytest.fixture
def prior() -> Prior:
    """An untrained prior, another one every time it is asked for."""
    torch.manual_seed(3)
    decoder = Decoder(SMALL)
    start_head(decoder)
    habits = Habits(
        0.05 * torch.randn(VARYING, CODE_SIZE),
        torch.tensor([-0.8, -1.0, -1.2, -3.0, 0.5, -1.5, -1.5, -1.5]),
        0.1 * torch.eye(VARYING),
    )
    encoder = Encoder(EncoderConfig(width=64)).eval()
    return Prior(encoder, decoder, Alignment().eval(), habits, {"steps": 0})


@pytest.fixture(scope="session")
def small_pack() -> Pack:
    """Two real materials, which are held out, and two simulated ones to train on."""
    simulated = [entry(f"simulated{index}", index, simulated=True) for index in (20, 21)]
    return Pack((entry("m0", 0), entry("m1", 1), *simulated))
