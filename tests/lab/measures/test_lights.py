"""Materials under the bench's lights and mirrored ones, and the imprint of the flash."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.flash.geometry import FlashSetup, camera_in_plane
from matcap.lab.measures.lights import (
    bench_scene,
    highlight_contrast,
    imprint,
    mirror_point,
    mirrored_scene,
    relight,
)
from matcap.lab.simulate.photograph import PhoneCamera
from matcap.lab.simulate.specimen import EXAMPLES

FLASH = FlashSetup(fov=65.0, intensity=(2.0, 2.0, 2.0))


def _grey(size, texel=2.0 / 256):
    full = torch.full((1, size, size), 0.5)
    return MapSet(full.expand(3, -1, -1), 0.0 * full, 2.0 * full, 0.0 * full, texel)


@pytest.mark.parametrize("example", EXAMPLES.values(), ids=EXAMPLES)
def test_lights_are_never_at_the_flash(example):
    setup = FlashSetup(fov=PhoneCamera().fov, offset=example.setup.offset, tilt=example.setup.tilt)
    flash = camera_in_plane(setup)[1]
    for light in bench_scene(setup).lights:
        place = torch.tensor(light.place, dtype=torch.float64)
        cosine = torch.dot(place, flash) / (place.norm() * flash.norm())
        assert math.degrees(math.acos(float(cosine))) > 12.0


def test_ten_lights_are_spread_over_the_hemisphere():
    lights = bench_scene(FLASH).lights
    places = np.array([light.place for light in lights])
    assert len(lights) == 10
    distance = np.linalg.norm(places, axis=1)
    assert distance.min() >= 1.5 and distance.max() <= 3.0 + 1e-9 and np.ptp(distance) > 1.0
    quadrants = {(bool(x > 0), bool(y > 0)) for x, y, _ in places}
    assert len(quadrants) == 4
    assert (places[:, 2] > 0.5).all()


def test_every_light_gives_the_flash_s_brightness_in_the_middle():
    scene = bench_scene(FLASH)
    expected = 0.5 / math.pi * 2.0 / FLASH.distance**2
    for light in scene.lights:
        middle = relight(_grey(65), FLASH.intensity, scene, light)[:, 32, 32]
        linear = ((middle + 0.055) / 1.055) ** 2.4
        # Schlick's term leaves a little specular even at F0 = 0.
        np.testing.assert_allclose(linear, expected, rtol=0.05)


def test_gain_between_flash_and_albedo_cancels():
    scene = bench_scene(FLASH)
    maps = _grey(32)
    halved = maps.map(lambda m: m)
    halved = MapSet(0.5 * maps.diffuse, *halved.stacked().split([3, 1, 1, 1])[1:], maps.texel_size)
    doubled = (4.0, 4.0, 4.0)
    for light in scene.lights[:3]:
        first = relight(maps, (2.0, 2.0, 2.0), scene, light)
        second = relight(halved, doubled, scene, light)
        assert torch.allclose(first, second, atol=0.01)


def test_strips_do_not_show():
    """Larger than a strip of rows; a tilted plane lit evenly has no lines."""
    maps = _grey(300)
    tilted = MapSet(
        maps.diffuse,
        maps.specular,
        maps.roughness,
        0.3 * torch.arange(300.0)[None, :, None].expand(1, 300, 300) * maps.texel_size,
        maps.texel_size,
    )
    scene = bench_scene(FLASH)
    picture = relight(tilted, FLASH.intensity, scene, scene.lights[4])
    assert (picture[:, 2:] - 2 * picture[:, 1:-1] + picture[:, :-2]).abs().max() < 1e-3


def test_finer_maps_are_averaged():
    scene = bench_scene(FLASH)
    coarse = relight(_grey(64), FLASH.intensity, scene, scene.lights[2])
    fine = relight(_grey(128, 1.0 / 256), FLASH.intensity, scene, scene.lights[2], size=(64, 64))
    torch.testing.assert_close(fine, coarse, atol=1e-4, rtol=0)
    blurred = relight(_grey(64), FLASH.intensity, scene, scene.lights[2], blur=0.8)
    torch.testing.assert_close(blurred, coarse, atol=2e-3, rtol=0)


def test_what_pixels_show_of_finer_maps_is_their_mean_radiance():
    # A checkerboard of black and white: half of white's light, not half of its code.
    scene = bench_scene(FLASH)
    board = (torch.arange(64)[:, None] + torch.arange(64)) % 2
    full = torch.full((1, 64, 64), 0.5)
    maps = MapSet((board * full).expand(3, -1, -1), 0.0 * full, 2.0 * full, 0.0 * full, 2.0 / 256)
    seen = relight(maps, FLASH.intensity, scene, scene.lights[2], size=(32, 32))
    half = (0.5 * FLASH.intensity[0], 0.5 * FLASH.intensity[1], 0.5 * FLASH.intensity[2])
    grey = relight(_grey(32, 2.0 / 128), half, scene, scene.lights[2])
    torch.testing.assert_close(seen, grey, atol=2e-3, rtol=0)


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
