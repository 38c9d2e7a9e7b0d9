"""Texels that cannot be told in single precision answer nothing, and end nothing."""

from __future__ import annotations

import torch

from matcap.capture.together.shared import texels_solved
from matcap.capture.together.texels import PARAMETERS, solved_in_place


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
