"""A photograph of the pack, and the shape of a decoder, that take no time."""

import numpy as np
import torch

from matcap.capture.coarse import CoarseFit
from matcap.flash.geometry import FlashSetup
from matcap.model.decoder import DecoderConfig
from matcap.model.order import Wave
from matcap.prior.corpus import srgb_bytes
from matcap.prior.pack import Entry

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
