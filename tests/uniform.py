"""Photographs of flat, uniform materials, rendered pixel by pixel in the picture's own frame.

Nothing here goes through the coarse fit's own formula: plane points come from unproject(), their
radiance from render_flash().
"""

import numpy as np
import torch

from matcap.brdf.maps import MapSet
from matcap.flash.geometry import FlashSetup, unproject
from matcap.flash.light import render_flash
from matcap.photo.photo import Photo


def photograph(
    setup,
    *,
    diffuse=(0.3, 0.25, 0.2),
    specular=0.04,
    roughness=0.4,
    noise=0.0,
    radiometric=True,
    size=(128, 96),
):
    """A Photo; what lies above 1 is clipped."""
    width, height = size
    u = (torch.arange(width, dtype=torch.float64) + 0.5) / width * 2.0 - 1.0
    v = (height - 2.0 * torch.arange(height, dtype=torch.float64) - 1.0) / width
    points = unproject(torch.stack([u.expand(height, width), v[:, None].expand(-1, width)]), setup)
    flat = torch.zeros(1, height, width, dtype=torch.float64)
    albedo = torch.tensor(diffuse, dtype=torch.float64)[:, None, None] + flat
    maps = MapSet(albedo, flat + specular, flat + roughness, flat, texel_size=2.0 / width)
    pixels = render_flash(maps, setup, points).permute(1, 2, 0).numpy()
    pixels = pixels * np.exp(noise * np.random.default_rng(0).standard_normal(pixels.shape))
    clipped = (pixels >= 1.0).any(axis=2)
    return Photo(
        pixels=np.minimum(pixels, 1.0).astype(np.float32),
        clipped=clipped,
        fov=setup.fov,
        fov_source="given",
        radiometric=radiometric,
        name="uniform",
        original_size=size,
    )


def a_setup(*, offset=(0.1, 0.05, 0.0), tilt=(0.0, 0.0), intensity=10.0):
    """A flash beside a phone's lens."""
    return FlashSetup(fov=65.0, offset=offset, tilt=tilt, intensity=(intensity,) * 3)
