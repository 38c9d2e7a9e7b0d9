"""Highlights under mirrored lights, and the imprint of the flash."""

from __future__ import annotations

import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.flash.geometry import FlashSetup
from matcap.lab.measures.gloss import highlight_contrast, imprint, mirror_point
from matcap.lab.measures.lights import mirrored_scene

SCENE = mirrored_scene(FlashSetup(fov=65.0))
ONE = torch.ones(1, 128, 128)


def even(roughness: float, specular: float = 0.04) -> MapSet:
    albedo = 0.2 * ONE.expand(3, -1, -1)
    return MapSet(albedo, specular * ONE, roughness * ONE, 0.0 * ONE, 1.0 / 128)


def test_every_mirror_image_is_in_the_picture() -> None:
    for light in SCENE.lights:
        assert max(map(abs, mirror_point(SCENE, light.place))) < 0.5


def test_glossier_is_stronger_and_matte_is_one() -> None:
    contrasts = [highlight_contrast(even(r), SCENE) for r in (0.25, 0.4, 0.95)]
    assert contrasts[0] > 2.0 * contrasts[1] > 2.0 * contrasts[2]
    assert contrasts[2] == pytest.approx(1.0, abs=0.05)


def test_rings_are_an_imprint_and_noise_is_none() -> None:
    v, u = torch.meshgrid(torch.arange(128.0), torch.arange(192.0), indexing="ij")
    away = torch.hypot(u - 96.0 - 19.2, v - 64.0)
    noise = torch.randn(128, 192, generator=torch.Generator().manual_seed(1))
    assert imprint(torch.sin(away * 0.5), (0.2, 0.0)) > 0.8
    assert abs(imprint(noise, (0.2, 0.0))) < 0.15
    assert abs(imprint(torch.sin(0.5 * u), (0.2, 0.0))) < 0.25  # a material's own direction
    assert imprint(torch.zeros(128, 192), (0.2, 0.0)) == 0.0
