"""Surfaces as numbers of which any is allowed: one way in, one way out."""

from __future__ import annotations

import math

import torch

from matcap.brdf.maps import MapSet
from matcap.brdf.parameters import (
    ALBEDO_LIMITS,
    F0_LIMITS,
    ROUGHNESS_LIMITS,
    SurfaceParameters,
)

TEXEL = 1.0 / 64.0


def _maps(least: float = 0.05, most: float = 0.95) -> MapSet:
    draw = torch.rand(6, 8, 12, generator=torch.Generator().manual_seed(1))
    return MapSet.from_stacked(least + (most - least) * draw, TEXEL)


def test_the_way_out_undoes_the_way_in() -> None:
    maps = _maps()
    parameters = SurfaceParameters.of(maps)
    assert torch.allclose(parameters.maps(TEXEL).stacked(), maps.stacked(), atol=1e-6)
    assert torch.equal(SurfaceParameters.from_stacked(maps.stacked()).stacked(), maps.stacked())


def test_what_comes_out_is_within_the_limits_whatever_went_in() -> None:
    wild = SurfaceParameters.from_stacked(200.0 * torch.randn(6, 8, 12))
    maps = wild.maps(TEXEL)
    for values, (least, most) in ((maps.diffuse, ALBEDO_LIMITS), (maps.specular, F0_LIMITS)):
        assert float(values.min()) >= least - 1e-6 and float(values.max()) <= most + 1e-6
    assert float(maps.roughness.min()) > 0.0 and float(maps.roughness.max()) < 1.0
    # Ends of what is taken in come back as they are.
    ends = MapSet.from_stacked(torch.tensor([0.0, 1.0])[None, None].expand(6, 1, 2), TEXEL)
    back = SurfaceParameters.of(ends).maps(TEXEL)
    assert torch.allclose(back.roughness, torch.tensor([[ROUGHNESS_LIMITS]]), atol=1e-6)


def test_departures_add_up() -> None:
    maps = _maps()
    uniform = SurfaceParameters.uniform((0.3, 0.2, 0.1), 0.04, 0.5)
    residuals = SurfaceParameters.of(maps) - uniform
    assert torch.allclose((uniform + residuals).maps(TEXEL).stacked(), maps.stacked(), atol=1e-6)
    assert torch.allclose(uniform.specular, torch.tensor(math.log(0.04)))
    assert float(uniform.roughness) == 0.0
    assert torch.equal(SurfaceParameters.from_vector(uniform.vector()).diffuse, uniform.diffuse)
