"""A small photograph, the shape of a small decoder, and an untrained prior, as a fixture too."""

import numpy as np
import pytest
import torch
from arrays import photo_from_array

from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.geometry import FlashSetup
from matcap.photo.photo import Photo
from matcap.space.decoder import CODE_SIZE, OUTPUTS, Decoder, DecoderConfig
from matcap.space.encoder import Encoder, EncoderConfig
from matcap.space.prior.store import VARYING, Anchors, ConditionalMean, Prior

SMALL = DecoderConfig(noise_channels=4, widths=(8, 8, 8, 8, 8), convolutions=(1, 1))


def small_light(seed: int) -> np.ndarray:
    """(192, 256, 3) linear light of a noisy, shaded brown picture."""
    import cv2

    rng = np.random.default_rng(seed)
    y, x = np.mgrid[-0.75:0.75:192j, -1.0:1.0:256j]
    shading = 0.4 / (1.0 + x**2 + y**2)
    noise = cv2.GaussianBlur(rng.normal(0.0, 1.0, (192, 256, 3)), (0, 0), 1.5)
    return shading[..., None] * np.array([0.6, 0.4, 0.3]) * np.exp(noise)


def small_photo(seed: int) -> Photo:
    """A photograph of it."""
    return photo_from_array(small_light(seed).clip(0.0, 0.99).astype(np.float32))


def coarse() -> CoarseFit:
    """Plausible numbers."""
    setup = FlashSetup(
        fov=60.0, offset=(0.1, 0.05, 0.0), tilt=(0.03, -0.02), intensity=(9.0,) * 3, vignetting=0.2
    )
    return CoarseFit((0.3, 0.2, 0.15), 0.04, 0.6, setup, 0.05)


@pytest.fixture
def prior() -> Prior:
    """An untrained prior, another one every time it is asked for."""
    return small_prior(3)


def small_prior(seed: int) -> Prior:
    """An untrained prior."""
    torch.manual_seed(seed)
    decoder = Decoder(SMALL)
    with torch.no_grad():
        affine = decoder.head.adain.affine
        affine.weight.mul_(0.2)
        affine.bias.copy_(torch.tensor([0.0] * OUTPUTS + [1.0] * 3 + [0.33] * 3))
    habits = ConditionalMean(
        0.05 * torch.randn(VARYING, CODE_SIZE),
        torch.tensor([-0.8, -1.0, -1.2, -3.0, 0.5, -1.5, -1.5, -1.5]),
        0.1 * torch.eye(VARYING),
    )
    encoder = Encoder(EncoderConfig(width=64)).eval()
    anchors = Anchors(*(torch.zeros(1, *size) for size in ((CODE_SIZE,), (VARYING,), (2, 2))))
    return Prior(encoder, decoder, habits, anchors, {"steps": 0})
