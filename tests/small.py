"""Small photographs, the shape of a small decoder, and an untrained prior, as fixtures too."""

import numpy as np
import pytest
import torch

from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.geometry import FlashSetup
from matcap.lab.train.corpus import srgb_bytes
from matcap.lab.train.pack import Entry, Pack
from matcap.lab.train.state import start_head
from matcap.space.decoder import CODE_SIZE, Decoder, DecoderConfig
from matcap.space.encoder import Encoder, EncoderConfig
from matcap.space.prior.anchors import ConditionalMean
from matcap.space.prior.base import VARYING
from matcap.space.prior.store import Prior
from matcap.statistics.lattice import Wave

SMALL = DecoderConfig(noise_channels=4, widths=(8, 8, 8, 8, 8), convolutions=(1, 1))


def jpeg(seed: int) -> bytes:
    """A noisy, shaded brown picture."""
    import cv2

    rng = np.random.default_rng(seed)
    y, x = np.mgrid[-0.75:0.75:192j, -1.0:1.0:256j]
    shading = 0.4 / (1.0 + x**2 + y**2)
    noise = cv2.GaussianBlur(rng.normal(0.0, 1.0, (192, 256, 3)), (0, 0), 1.5)
    linear = shading[..., None] * np.array([0.6, 0.4, 0.3]) * np.exp(noise)
    return cv2.imencode(".jpg", srgb_bytes(linear.clip(0.0, 1.0)))[1].tobytes()


def coarse() -> CoarseFit:
    """Plausible numbers."""
    setup = FlashSetup(
        fov=60.0, offset=(0.1, 0.05, 0.0), tilt=(0.03, -0.02), intensity=(9.0,) * 3, vignetting=0.2
    )
    return CoarseFit((0.3, 0.2, 0.15), 0.04, 0.6, setup, 0.05)


def entry(name: str, seed: int, *, simulated: bool = False) -> Entry:
    """A photograph of the pack."""
    return Entry(
        name=f"{name}_{seed}.jpg",
        material=name,
        simulated=simulated,
        jpeg=jpeg(seed),
        coarse=coarse(),
        contrast=torch.tensor([0.2, 0.3, 0.25]),
        waves=(Wave(0.05, 0.01),) if simulated else (),
        tilt=(0.1, -0.2) if simulated else None,
    )


@pytest.fixture(scope="session")
def pack() -> Pack:
    """Thirteen real materials, so that one is left to train on, and a simulated one."""
    real = [entry(f"m{index}", index) for index in range(13)]
    return Pack((*real, entry("simulated", 99, simulated=True)))


@pytest.fixture
def prior() -> Prior:
    """An untrained prior, another one every time it is asked for."""
    return small_prior(3)


def small_prior(seed: int) -> Prior:
    """An untrained prior."""
    torch.manual_seed(seed)
    decoder = Decoder(SMALL)
    start_head(decoder)
    habits = ConditionalMean(
        0.05 * torch.randn(VARYING, CODE_SIZE),
        torch.tensor([-0.8, -1.0, -1.2, -3.0, 0.5, -1.5, -1.5, -1.5]),
        0.1 * torch.eye(VARYING),
    )
    encoder = Encoder(EncoderConfig(width=64)).eval()
    return Prior(encoder, decoder, habits, {"steps": 0})


@pytest.fixture(scope="session")
def small_pack() -> Pack:
    """Two real materials, which are held out, and two simulated ones to train on."""
    simulated = [entry(f"simulated{index}", index, simulated=True) for index in (20, 21)]
    return Pack((entry("m0", 0), entry("m1", 1), *simulated))
