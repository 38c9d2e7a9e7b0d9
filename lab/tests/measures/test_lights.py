"""Materials under the bench's lights and mirrored ones, and the imprint of the flash."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.flash.geometry import FlashSetup, camera_in_plane
from matcap_lab.measures.evaluator import (
    BenchScene,
    bench_scene,
    highlight_contrast,
    imprint,
    mirror_point,
    mirrored_scene,
    relight_all,
)
from matcap_lab.simulate.photograph import PhoneCamera
from matcap_lab.simulate.specimen import EXAMPLES

FLASH = FlashSetup(fov=65.0, intensity=(2.0, 2.0, 2.0))
BENCH = bench_scene(FLASH)
MIRRORED = mirrored_scene(FLASH)


def even(size, texel=2.0 / 256, *, albedo=0.5, specular=0.0, roughness=1.0):
    one = torch.ones(1, size, size)
    return MapSet(albedo * one.expand(3, -1, -1), specular * one, roughness * one, 0.0 * one, texel)


def relight(maps, light, intensity=FLASH.intensity, **options):
    """A picture under one light."""
    return relight_all(maps, intensity, BenchScene(FLASH.distance, (light,)), **options)[0]


@pytest.mark.parametrize("example", EXAMPLES.values(), ids=EXAMPLES)
def test_lights_are_never_at_the_flash(example):
    setup = FlashSetup(fov=PhoneCamera().fov, offset=example.setup.offset, tilt=example.setup.tilt)
    flash = camera_in_plane(setup)[1]
    for light in bench_scene(setup).lights:
        place = torch.tensor(light.place, dtype=torch.float64)
        cosine = torch.dot(place, flash) / (place.norm() * flash.norm())
        assert math.degrees(math.acos(float(cosine))) > 12.0


def test_ten_lights_are_spread_over_the_hemisphere():
    places = np.array([light.place for light in BENCH.lights])
    assert len(places) == 10
    distance = np.linalg.norm(places, axis=1)
    assert distance.min() >= 1.5 and distance.max() <= 3.0 + 1e-9 and np.ptp(distance) > 1.0
    quadrants = {(bool(x > 0), bool(y > 0)) for x, y, _ in places}
    assert len(quadrants) == 4
    assert (places[:, 2] > 0.5).all()


def test_every_light_gives_the_flash_s_brightness_in_the_middle():
    expected = 0.5 / math.pi * 2.0 / FLASH.distance**2
    for light in BENCH.lights:
        middle = relight(even(65), light)[:, 32, 32]
        linear = ((middle + 0.055) / 1.055) ** 2.4
        # Schlick's term leaves a little specular even at F0 = 0.
        np.testing.assert_allclose(linear, expected, rtol=0.05)


def test_gain_between_flash_and_albedo_cancels():
    for light in BENCH.lights[:3]:
        first = relight(even(32), light)
        second = relight(even(32, albedo=0.25), light, (4.0, 4.0, 4.0))
        assert torch.allclose(first, second, atol=0.01)


def test_strips_do_not_show():
    """Larger than a strip of rows; a tilted plane lit evenly has no lines."""
    maps = even(300)
    height = 0.3 * maps.texel_size * torch.arange(300.0)[None, :, None].expand(1, 300, 300)
    tilted = replace(maps, height=height)
    picture = relight(tilted, BENCH.lights[4])
    assert (picture[:, 2:] - 2 * picture[:, 1:-1] + picture[:, :-2]).abs().max() < 1e-3


def test_finer_maps_are_averaged():
    light = BENCH.lights[2]
    coarse = relight(even(64), light)
    fine = relight(even(128, 1.0 / 256), light, size=(64, 64))
    torch.testing.assert_close(fine, coarse, atol=1e-4, rtol=0)
    blurred = relight(even(64), light, blur=0.8)
    torch.testing.assert_close(blurred, coarse, atol=2e-3, rtol=0)


def test_what_pixels_show_of_finer_maps_is_their_mean_radiance():
    # A checkerboard of black and white: half of white's light, not half of its code.
    board = (torch.arange(64)[:, None] + torch.arange(64)) % 2
    maps = even(64, albedo=0.5 * board)
    seen = relight(maps, BENCH.lights[2], size=(32, 32))
    grey = relight(even(32, 2.0 / 128), BENCH.lights[2], (1.0, 1.0, 1.0))
    torch.testing.assert_close(seen, grey, atol=2e-3, rtol=0)


def test_every_mirror_image_is_in_the_picture() -> None:
    for light in MIRRORED.lights:
        assert max(map(abs, mirror_point(MIRRORED, light.place))) < 0.5


def test_glossier_is_stronger_and_matte_is_one() -> None:
    contrasts = [
        highlight_contrast(even(128, 1.0 / 128, albedo=0.2, specular=0.04, roughness=r), MIRRORED)
        for r in (0.25, 0.4, 0.95)
    ]
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
