"""Relief is scaled to the contrast of glints."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from photographed import photographed

from matcap.capture.exemplar.refine import scaled_by_glints
from matcap.flash.render import render_flash

HEIGHT, WIDTH = 192, 256


def scene(albedo: float, roughness: float):
    """Photograph, its light and true residuals of an even surface with relief."""
    shot = photographed(0.06, 0.0, width=WIDTH, height=HEIGHT)
    one = torch.ones(1, HEIGHT, WIDTH)
    maps = replace(
        shot.maps,
        diffuse=albedo * one.expand(3, -1, -1),
        specular=0.04 * one,
        roughness=roughness * one,
    )
    light = shot.light
    linear = render_flash(maps, shot.uniform.setup, shot.points)
    return linear / float(linear.quantile(0.99)), light, light.residuals(maps)


def factor(albedo: float, roughness: float, strength: float) -> float:
    """What relief is scaled by where it was predicted `strength` times as strong as it is."""
    linear, light, truth = scene(albedo, roughness)
    guess = replace(truth, height=strength * truth.height)
    noise = torch.full_like(linear, 1e-3)
    found = scaled_by_glints(guess, linear, linear < 1.0, light, noise)
    return float(found.height.std() / guess.height.std())


@pytest.mark.parametrize("strength", [0.3, 1.0, 1.5])
def test_relief_gets_the_strength_of_the_glints(strength: float) -> None:
    assert factor(0.003, 0.5, strength) == pytest.approx(1.0 / strength, rel=0.25)


def test_a_matte_photograph_leaves_relief_alone() -> None:
    assert factor(0.5, 0.9, 0.3) == 1.0


def test_a_pattern_under_a_glaze_is_no_relief() -> None:
    _, light, truth = scene(0.1, 0.3)
    noise = np.random.default_rng(1).normal(size=(HEIGHT, WIDTH)).astype(np.float32)
    drawing = torch.from_numpy(cv2.GaussianBlur(noise, (0, 0), 3.0))[None]
    drawing = drawing / drawing.std()
    flat = replace(truth, diffuse=truth.diffuse + drawing, height=0.0 * truth.height)
    maps = light.maps(flat)
    linear = light.flash.onto(maps.normal).log_radiance(maps)[0].exp()
    linear = linear / float(linear.quantile(0.99))
    guess = replace(truth, height=0.03 * truth.height)  # and an albedo that is even
    scaled = scaled_by_glints(guess, linear, linear < 1.0, light, 1e-3 * torch.ones_like(linear))
    slope, before = (each.height.diff(dim=2).std() for each in (scaled, guess))
    assert float(slope) < 1.3 * float(before)
