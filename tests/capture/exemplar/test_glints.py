"""White glints of coloured materials are no albedo."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from photographed import SETUP, photographed, whole_plane

from matcap.capture.exemplar.glints import without_glints
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.light import render_flash

WOOD = (0.2, 0.08, 0.03)


def _wood(albedo: tuple[float, float, float] = WOOD) -> tuple[torch.Tensor, CoarseFit]:
    """A photograph of flat wood, its grain a log contrast of 0.2, and what it was fitted by."""
    shot = photographed(0.0001, 0.2)
    uniform = CoarseFit(albedo, 0.04, 0.4, SETUP, residual=0.0)
    tone = shot.maps.diffuse[:1] / shot.uniform.diffuse[0]
    maps = replace(
        shot.maps,
        diffuse=torch.tensor(albedo)[:, None, None] * tone,
        roughness=torch.full_like(shot.maps.roughness, 0.4),
    )
    return render_flash(maps, SETUP, shot.points), uniform


def _dashes(light: torch.Tensor) -> torch.Tensor:
    """(H, W) bool: dashes along a streak through the highlight, 6 % of it."""
    where = torch.zeros(light.shape[-2:], dtype=torch.bool)
    for row in range(20, 364, 6):
        column = 240 + (7 * row) % 50
        where[row : row + 2, column : column + 10] = True
    return where


def test_glints_along_a_streak_are_taken_off_and_nothing_else() -> None:
    light, uniform = _wood()
    where = _dashes(light)
    bright = light + where * light.mean()
    found = without_glints(whole_plane(bright), uniform).linear
    left = (found - light)[:, where].abs().mean() / (bright - light)[:, where].abs().mean()
    assert left < 0.5
    assert torch.equal(found[:, ~where], light[:, ~where])


def test_a_white_mark_of_wood_stays() -> None:
    light, uniform = _wood()
    where = torch.zeros(light.shape[-2:], dtype=torch.bool)
    where[300:304, 60:66] = True
    marked = torch.where(where, 5.0 * light[2:].expand_as(light), light)
    assert torch.equal(without_glints(whole_plane(marked), uniform).linear, marked)


@pytest.mark.parametrize("conductor", [False, True])
def test_grey_and_metal_are_unchanged(conductor: bool) -> None:
    light, uniform = _wood(WOOD if conductor else (0.1, 0.1, 0.09))
    plane = whole_plane(light + _dashes(light) * light.mean())
    assert without_glints(plane, replace(uniform, conductor=conductor)) is plane
