"""Highlights are found where the plane mirrors the flash, and coarse fits keep them."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from uniform import a_setup, photograph

from matcap.flash.coarse.fit import fit_coarse
from matcap.flash.highlight import elongation, find_highlight, light_of


def polished(*, roughness, intensity=10.0, offset=(0.1, 0.05, 0.0), tilt=(0.0, 0.0), **material):
    setup = a_setup(offset=offset, tilt=tilt, intensity=intensity)
    return photograph(setup, roughness=roughness, size=(256, 192), **material)


def assert_kept(photo, fit):
    """The fit's re-rendering, clipped as the camera clips, has the photograph's highlight."""
    size = photo.pixels.shape[1::-1]
    uniform = {"diffuse": fit.diffuse, "specular": fit.specular, "roughness": fit.roughness}
    again = fit.tone.developed(photograph(fit.setup, size=size, **uniform).pixels)
    again = find_highlight(np.minimum(again, 1.0).mean(axis=2))
    there = find_highlight(light_of(photo.pixels))
    assert there is not None and again is not None
    assert math.dist(there.centre, again.centre) < 0.03
    assert again.width == pytest.approx(there.width, rel=0.2)
    assert again.contrast == pytest.approx(there.contrast, rel=0.2)


@pytest.mark.parametrize("offset", [(0.2, 0.0, 0.0), (-0.1, 0.16, 0.0)])
def test_a_highlight_is_half_way_to_the_flash(offset):
    found = find_highlight(light_of(polished(roughness=0.2, offset=offset).pixels))
    assert found.centre == pytest.approx((offset[0] / 2, offset[1] / 2), abs=0.012)


def test_clipping_does_not_move_it():
    dim = find_highlight(light_of(polished(roughness=0.25, intensity=2.0).pixels))
    bright = find_highlight(light_of(polished(roughness=0.25, intensity=20.0).pixels))
    assert bright.peak < 1.01 < dim.contrast
    assert bright.centre == pytest.approx(dim.centre, abs=0.015)
    assert bright.contrast < dim.contrast


def test_rougher_is_wider():
    widths = [
        find_highlight(light_of(polished(roughness=r, intensity=0.1).pixels)).width
        for r in (0.2, 0.3, 0.4)
    ]
    assert widths[0] < 0.85 * widths[1] < 0.72 * widths[2]


def patches(seed, least):
    """(192, 256, 1) bool, blots that cover less the more deviations they are above the mean."""
    noise = np.random.default_rng(seed).standard_normal((192, 256)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 3.0)
    return (smooth > least * smooth.std())[..., None]


def bare_metal(seed, least):
    """Highlights of metal alone, and of patches of it in rust."""
    metal = polished(roughness=0.3, specular=0.5, diffuse=(0.02,) * 3).pixels
    rust = polished(roughness=0.9, diffuse=(0.1, 0.05, 0.02)).pixels
    mixed = np.where(patches(seed, least), metal, rust)
    return find_highlight(light_of(metal)), find_highlight(light_of(mixed))


def test_patches_of_metal_make_one_highlight_together():
    """Between rust every patch is as bright as a highlight is, and far smaller than this one."""
    alone, found = bare_metal(0, 0.5)
    assert math.dist(found.centre, alone.centre) < 0.08
    assert found.width == pytest.approx(alone.width, rel=0.2)


def test_a_flake_twice_as_bright_as_others_is_no_highlight():
    alone, found = bare_metal(4, 1.4)
    assert found.width > 0.5 * alone.width  # the flake's is 0.17 of it


def test_pale_leaves_on_dark_ground_have_none():
    """The brightest of them is one of many; seldom do they happen to crowd into a spot."""
    leaf, ground = (polished(roughness=0.9, diffuse=(a,) * 3).pixels for a in (0.5, 0.08))
    strewn = (np.where(patches(seed, 1.4), leaf, ground) for seed in range(16))
    assert sum(find_highlight(light_of(each)) is None for each in strewn) >= 8


def test_matt_and_plaid_have_none():
    assert find_highlight(light_of(polished(roughness=0.9).pixels)) is None
    white = np.kron(np.indices((12, 16)).sum(0) % 2, np.ones((16, 16)))
    assert find_highlight(0.1 + 0.8 * white) is None


@pytest.mark.parametrize("radiometric", [True, False], ids=["raw", "developed"])
def test_a_sharp_clipped_spot_on_black_stone_is_kept(radiometric):
    photo = polished(
        roughness=0.15, diffuse=(0.02,) * 3, intensity=12.0, radiometric=radiometric, noise=0.05
    )
    assert 0.0002 < photo.clipped_share < 0.03
    fit = fit_coarse(photo)
    assert_kept(photo, fit)
    assert fit.roughness < 0.25
    # Of a developed picture the priors say how much is flash beside the lens, how much tilt.
    assert math.dist(fit.setup.offset[:2], (0.1, 0.05)) < (0.05 if radiometric else 0.08)


def test_a_spike_in_a_haze_is_kept():
    spike = polished(roughness=0.16, specular=0.02, diffuse=(0.05,) * 3)
    haze = polished(roughness=0.5, specular=0.04, diffuse=(0.05,) * 3)
    pixels = np.minimum(0.5 * (spike.pixels + haze.pixels), 1.0)
    photo = replace(spike, pixels=pixels, clipped=(pixels >= 1.0).any(axis=2), radiometric=False)
    assert_kept(photo, fit_coarse(photo))


@pytest.mark.parametrize("tilt", [(0.17, 0.05), (-0.1, 0.2)])
def test_a_tilted_plane_is_not_taken_for_a_flash_far_off(tilt):
    photo = polished(roughness=0.35, tilt=tilt, noise=0.03)
    setup = fit_coarse(photo).setup
    assert math.dist(setup.offset[:2], (0.1, 0.05)) < 0.03
    assert math.degrees(math.dist(setup.tilt, tilt)) < 1.5


def ellipse(ratio: float, angle: float, width: float) -> np.ndarray:
    """(192, 256) a Gaussian spot on grey, `ratio` times as long as wide."""
    u = (np.arange(256) + 0.5)[None] * 2.0 / 256 - 1.0 - 0.1
    v = (192 - 2.0 * (np.arange(192) + 0.5)[:, None]) / 256 + 0.05
    along = u * math.cos(angle) + v * math.sin(angle)
    aside = -u * math.sin(angle) + v * math.cos(angle)
    return 0.1 + 0.8 * np.exp(-0.5 * ((along / (width * ratio)) ** 2 + (aside / width) ** 2))


@pytest.mark.parametrize("width", [0.015, 0.08, 0.15])
@pytest.mark.parametrize(("ratio", "angle"), [(1.0, 0.0), (1.5, 0.4), (1.5, -1.2), (2.0, 1.5)])
def test_length_over_width(ratio: float, angle: float, width: float) -> None:
    light = ellipse(ratio, angle, width)
    highlight = find_highlight(light)
    assert highlight is not None
    # A blur of 0.3 widths makes it a little rounder.
    assert 0.9 * ratio < elongation(light, highlight) < 1.05 * ratio
