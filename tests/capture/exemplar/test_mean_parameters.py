"""Levels of gloss from the profile of the highlight."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from photographed import photographed

from matcap.brdf.parameters import SurfaceParameters
from matcap.capture.exemplar.mean_parameters import (
    MeanParameterPrior,
    RingTarget,
    fit_mean_parameters,
)
from matcap.flash.geometry import flash_mirror_point
from matcap.flash.light import FlashLight
from matcap.flash.render import Uniform, render_flash

HEIGHT, WIDTH = 192, 256
ONE = torch.ones(1, HEIGHT, WIDTH)
PRIOR = MeanParameterPrior(torch.zeros(1, 5), torch.tensor([[1.0, 1.0, 1.0, 0.15, 1.0]]))


def glossy(roughness: float, brightness: float = 1.0) -> tuple[RingTarget, Uniform]:
    """A photograph of an even dielectric with relief, and the surface that it is fitted from."""
    shot = photographed(0.05, 0.0, width=WIDTH, height=HEIGHT)
    maps = replace(
        shot.maps,
        diffuse=0.2 * ONE.expand(3, -1, -1),
        specular=0.04 * ONE,
        roughness=roughness * ONE,
    )
    linear = render_flash(maps, shot.uniform.setup, shot.points)
    linear = linear * (0.3 / linear.median()) * brightness
    gain = float(linear.median() / render_flash(maps, shot.uniform.setup, shot.points).median())
    intensity = tuple(gain * power for power in shot.uniform.setup.intensity)
    setup = shot.uniform.setup.with_intensity(intensity)
    uniform = Uniform((0.3, 0.3, 0.3), 0.04, 0.5, setup)
    x, y = flash_mirror_point(setup)
    target = RingTarget(
        linear=linear.clamp_max(1.0),
        measured=linear < 1.0,
        counts=torch.ones(HEIGHT, WIDTH, dtype=torch.bool),
        distance=torch.hypot(shot.points[0] - x, shot.points[1] - y),
        flash=FlashLight.of(setup, shot.points),
        normal=maps.normal,
        surface=uniform.parameters(),
    )
    return target, uniform


def fitted(target: RingTarget, uniform: Uniform) -> tuple[float, float, float]:
    """Mean albedo, F0 and roughness."""
    levels, _ = fit_mean_parameters(target, ONE, torch.zeros(1, 5), PRIOR)
    found = (uniform.parameters() + SurfaceParameters.from_vector(levels[0])).reflectance()
    return float(found.diffuse.mean()), float(found.specular), float(found.roughness)


@pytest.mark.parametrize("roughness", [0.2, 0.35, 0.6])
def test_levels_are_found_under_relief(roughness: float) -> None:
    albedo, f0, found = fitted(*glossy(roughness, 0.2))
    assert albedo == pytest.approx(0.2, rel=0.1)
    assert f0 == pytest.approx(0.04, rel=0.15)
    assert found == pytest.approx(roughness, rel=0.1)


def test_a_clipped_core_is_a_lower_bound() -> None:
    target, uniform = glossy(0.25)
    assert 0.01 < float((~target.measured).float().mean()) < 0.1
    assert fitted(target, uniform)[2] == pytest.approx(0.25, rel=0.1)


def test_what_is_clipped_everywhere_is_raised_and_never_lowered() -> None:
    target, uniform = glossy(0.6, 0.2)
    nothing = replace(target, measured=torch.zeros_like(target.measured))
    bright = replace(nothing, surface=nothing.surface + _paler(1.0))
    levels, _ = fit_mean_parameters(bright, ONE, torch.zeros(1, 5), PRIOR)
    assert float(levels.abs().max()) < 0.05
    dark = replace(nothing, surface=nothing.surface + _paler(-2.0))
    levels, _ = fit_mean_parameters(dark, ONE, torch.zeros(1, 5), PRIOR)
    assert float(levels[0, :3].min()) > 0.5


def _paler(by: float) -> SurfaceParameters:
    return SurfaceParameters.from_vector(torch.tensor([by, by, by, 0.0, 0.0]))
