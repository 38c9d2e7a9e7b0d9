"""Texels that cannot be told in single precision answer nothing, and end nothing."""

from __future__ import annotations

import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.capture.multiview.ambient_light import AmbientLight
from matcap.capture.multiview.shared import texels_solved
from matcap.capture.multiview.texels import (
    PARAMETERS,
    derivatives,
    jacobian,
    log_rendered,
    parameters_of,
    solved_in_place,
)
from matcap.flash.light import FlashLight


def test_sound_texels_are_solved() -> None:
    draw = torch.randn(5, PARAMETERS, 12, generator=torch.Generator().manual_seed(0))
    within = draw @ draw.mT
    sides = torch.ones(5, PARAMETERS, 2)
    found = texels_solved(within.movedim(0, -1), sides.movedim(0, -1)).movedim(-1, 0)
    assert torch.allclose(within @ found, sides, atol=1e-2)


def test_texels_told_many_times_over_answer_finitely_or_nothing() -> None:
    # One direction told by 1e9, all others by next to nothing: rounding makes it indefinite.
    steep = torch.linspace(0.2, 1.0, PARAMETERS)
    within = 1e9 * steep[:, None] * steep + 1e-3 * torch.eye(PARAMETERS)
    lost = within.clone()
    lost[0, 0] -= 2e3
    texels = torch.stack([within, lost, -within], dim=-1)
    found = texels_solved(texels, 1e3 * torch.ones(PARAMETERS, 1, 3))
    assert bool(torch.isfinite(found).all())
    assert float(found.abs().max()) < 1e6
    assert not found[..., 2].any()


def test_systems_side_by_side_are_solved_as_one_after_the_other() -> None:
    draw = torch.randn(9, PARAMETERS, 12, generator=torch.Generator().manual_seed(1))
    within, right = draw @ draw.mT, draw[..., 0]
    within[4] *= -1.0
    factor = torch.cat([within.movedim(0, -1), right.T[None]])
    found = solved_in_place(factor)[:, 0]
    sound = torch.arange(9) != 4
    wanted = torch.linalg.solve(within[sound].double(), right[sound].double()).float()
    assert torch.allclose(found.T[sound], wanted, rtol=1e-2, atol=1e-3)
    lower = factor[:PARAMETERS].movedim(-1, 0).tril()[sound]
    assert torch.allclose(lower, torch.linalg.cholesky(within[sound]), rtol=1e-3, atol=1e-4)
    assert bool(found[:, 4].isnan().all())


_POINTS = torch.cat(
    [torch.rand(2, 6, 7, generator=torch.Generator().manual_seed(2)), torch.zeros(1, 6, 7)]
)
_LIGHTS = (
    FlashLight.between(
        _POINTS.double(),
        torch.tensor([0.1, 0.0, 2.0]),
        torch.tensor([0.2, -0.1, 2.0]),
        torch.tensor([1.0, 2.0, 3.0]),
    ),
    AmbientLight(torch.tensor([0.2, 0.3, 0.5]), torch.tensor([1.0, 2.0, 3.0])[:, None, None]),
)


@pytest.mark.parametrize("light", _LIGHTS)
def test_derivatives_are_those_of_the_rendered_radiance(light) -> None:
    draw = torch.randn(PARAMETERS, 6, 7, generator=torch.Generator().manual_seed(3)).double()
    level = torch.tensor([-1.5, -1.5, -1.5, -3.0, 0.0, 0.0, 0.0])[:, None, None]
    texels = level + 0.4 * draw
    ((log, *shown),) = derivatives(texels, [light])
    assert torch.equal(log, log_rendered(texels, [light])[0])
    for number, found in enumerate(jacobian(*shown)):
        step = torch.zeros(PARAMETERS, 1, 1).double()
        step[number] = 1e-5
        ahead, behind = (log_rendered(texels + s, [light])[0] for s in (step, -step))
        torch.testing.assert_close(found, ((ahead - behind) / 2e-5).flatten(1), atol=1e-6, rtol=0)


def test_maps_beyond_their_limits_have_finite_parameters() -> None:
    """Cubic interpolation overshoots at a step, as of bare metal next to rust."""
    plane = torch.tensor([[[-0.03, 0.2, 1.04]]])
    maps = MapSet(plane.expand(3, 1, 3), plane, plane, torch.zeros(1, 1, 3), texel_size=0.01)
    assert bool(torch.isfinite(parameters_of(maps)).all())
