"""The inverse network: what it is told, what it answers, and how that is read."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.brdf.parameters import SurfaceParameters
from matcap.capture.exemplar.network.inputs import network_inputs
from matcap.capture.exemplar.network.network import (
    ANSWERS,
    INPUTS,
    Inverse,
    InverseConfig,
    NetworkAnswer,
    NetworkInputs,
)
from matcap.flash.geometry import FlashSetup, camera_in_plane, plane_points
from matcap.flash.light import FlashLight
from matcap.flash.render import Uniform, render_flash, uniform_radiance

SETUP = FlashSetup(fov=60.0, offset=(0.1, -0.05, 0.0), tilt=(0.05, -0.03), intensity=(8.0,) * 3)
UNIFORM = Uniform((0.3, 0.2, 0.1), 0.04, 0.5, SETUP)
TINY = InverseConfig(widths=(8, 8, 12), context=8)


def _inputs(height: int, width: int) -> torch.Tensor:
    """(1, INPUTS, height, width) of all texels valid, some gloss everywhere."""
    inputs = NetworkInputs.from_stacked(torch.randn(1, INPUTS, height, width))
    gloss = inputs.gloss.abs().clamp_max(1.0)
    return replace(inputs, valid=torch.ones_like(gloss), gloss=gloss).stacked()


def _points(width: int, height: int) -> torch.Tensor:
    return plane_points(0, 0, width, height, (width, height), dtype=torch.float32)


def _flat(width: int, height: int) -> MapSet:
    one = torch.ones(1, height, width)
    return MapSet(
        torch.tensor(UNIFORM.diffuse)[:, None, None] * one,
        0.04 * one,
        0.5 * one,
        0.0 * one,
        2.0 / width,
    )


def test_uniform_radiance_is_what_the_renderer_makes_of_flat_maps() -> None:
    points = _points(64, 48)
    expected = render_flash(_flat(64, 48), SETUP, points)
    found, diffuse = uniform_radiance(UNIFORM, FlashLight.of(SETUP, points))
    assert torch.allclose(found, expected, rtol=1e-4)
    assert bool((diffuse < found).all())


def test_a_photograph_of_the_uniform_material_departs_nowhere() -> None:
    points = _points(256, 192)
    linear = render_flash(_flat(256, 192), SETUP, points)
    inputs = network_inputs(linear, torch.ones(192, 256, dtype=torch.bool), UNIFORM, points)
    assert inputs.stacked().shape == (INPUTS, 192, 256)
    assert float(inputs.log.abs().max()) < 0.01


@pytest.mark.parametrize("fov", [40.0, 65.0, 90.0])
def test_matte_slopes_show_as_the_tangent_of_the_lights_direction(fov: float) -> None:
    """d log(n.l) / d slope at a flat place is -l_xy / l_z."""
    setup = FlashSetup(fov=fov, offset=(0.08, 0.02, 0.0))
    matte = Uniform((0.5, 0.5, 0.5), 1e-6, 0.99, setup)
    points = _points(64, 48)
    inputs = network_inputs(
        torch.full((3, 48, 64), 0.2), torch.ones(48, 64, dtype=torch.bool), matte, points
    )
    light = camera_in_plane(setup)[1].float()[:, None, None]
    tangent = (light - points)[:2] / (light - points)[2:]
    assert torch.allclose(inputs.tangent, tangent, atol=0.01)
    assert torch.allclose(inputs.slope_sensitivity, -tangent, atol=0.02)


def test_reading_undoes_writing() -> None:
    generator = torch.Generator().manual_seed(3)
    draw = lambda channels: torch.rand(channels, 8, 12, generator=generator)  # noqa: E731
    maps = MapSet(
        0.1 + 0.5 * draw(3), 0.03 + 0.1 * draw(1), 0.2 + 0.6 * draw(1), 0.1 * draw(1), 2.0 / 12
    )
    uniform = UNIFORM.parameters()
    residuals = SurfaceParameters.of(maps) - uniform
    again = (uniform + residuals).maps(maps.texel_size)
    assert torch.allclose(again.stacked(), maps.stacked(), atol=1e-5)


def test_reads_pictures_of_any_aspect_and_starts_from_the_photograph_as_albedo() -> None:
    torch.manual_seed(0)
    network = Inverse(TINY).eval()
    for height, width in ((32, 64), (96, 32)):
        inputs = _inputs(height, width)
        with torch.no_grad():
            answer = network(inputs)
        assert answer.shape == (1, ANSWERS, height, width)
        albedo = NetworkAnswer.from_stacked(answer).residuals.diffuse
        assert float((albedo - NetworkInputs.from_stacked(inputs).log).abs().mean()) < 0.5


def test_what_is_seen_in_one_corner_is_told_in_the_other() -> None:
    """Pooled context reaches farther than any convolution does."""
    torch.manual_seed(0)
    network = Inverse(TINY).eval()
    inputs = _inputs(256, 256)
    changed = inputs.clone()
    changed[..., :32, :32] += 2.0
    with torch.no_grad():
        apart = (network(inputs) - network(changed))[..., -16:, -16:]
    assert float(apart.abs().max()) > 1e-6


def test_gradients_reach_every_weight() -> None:
    torch.manual_seed(0)
    network = Inverse(TINY)
    network(_inputs(32, 32)).square().mean().backward()
    silent = [name for name, p in network.named_parameters() if not p.grad.abs().sum() > 0]
    assert silent == []


def test_a_clipped_hot_spot_and_darkness_give_finite_inputs() -> None:
    points = _points(64, 48)
    linear = torch.zeros(3, 48, 64)
    linear[:, 20:28, 28:36] = 1.0
    valid = (linear < 0.98).all(0)
    polished = Uniform((0.001, 0.001, 0.001), 0.9, 0.03, SETUP)
    inputs = network_inputs(linear, valid, polished, points)
    assert bool(torch.isfinite(inputs.stacked()).all())
    assert math.isclose(float(inputs.valid.mean()), float(valid.float().mean()), rel_tol=1e-5)
