"""Metal's colour: told by what is seen of it, and no colour where nothing is metal."""

from __future__ import annotations

from dataclasses import replace

import torch
from photographed import photographed

from matcap.capture.exemplar.network.network import ExpectedErrors
from matcap.capture.exemplar.refine import refine_albedo
from matcap.capture.exemplar.tint import has_metal, seen_colour, specular_tint
from matcap.flash.render import render_flash

GOLD = torch.tensor([1.0, 0.766, 0.336])[:, None, None]


def half_gold():
    """A shot whose right half is gold; (shot, its maps, its photograph, where metal is)."""
    shot = photographed(0.15, 0.1, width=96, height=64)
    metal = torch.zeros(1, 64, 96)
    metal[..., 48:] = 1.0
    maps = replace(
        shot.maps,
        diffuse=shot.maps.diffuse * (1.0 - metal) + 1e-3 * metal,
        specular=shot.maps.specular * (1.0 - metal) + 0.9 * GOLD * metal,
    )
    return shot, maps, render_flash(maps, shot.uniform.setup, shot.points), metal


def test_metal_is_seen_in_its_own_colour() -> None:
    _, _, linear, _ = half_gold()
    seen = seen_colour(linear, torch.ones(1, 64, 96))
    assert torch.allclose(seen.mean(0), torch.ones(64, 96), atol=1e-5)
    assert float((seen[:, :, 56:-4] / (GOLD / GOLD.mean()) - 1.0).abs().mean()) < 0.03


def test_clipped_texels_say_nothing_of_colour() -> None:
    _, _, linear, _ = half_gold()
    burnt = linear.clone()
    burnt[:, 30, 70] = 1e3
    measured = (burnt < 10.0).all(0, keepdim=True)
    whole = torch.ones_like(measured)
    assert torch.allclose(seen_colour(burnt, measured), seen_colour(linear, whole), atol=0.05)
    assert torch.allclose(seen_colour(linear, ~whole), torch.ones(3, 64, 96))


def test_what_is_no_metal_stays_grey_and_doubt_counts_as_none() -> None:
    assert not has_metal(torch.full((1, 8, 8), -2.0))
    assert has_metal(torch.linspace(-6.0, 6.0, 64).reshape(1, 8, 8))
    colour = seen_colour(torch.rand(3, 8, 8), torch.ones(1, 8, 8, dtype=torch.bool))
    assert torch.equal(specular_tint(torch.zeros(1, 8, 8), colour), torch.ones(3, 8, 8))


def test_refining_keeps_hue_and_finds_how_bright_metal_is() -> None:
    shot, maps, linear, metal = half_gold()
    measured = torch.ones(3, 64, 96, dtype=torch.bool)
    tint = specular_tint(metal, seen_colour(linear, metal))
    light = replace(shot.light, tint=tint)
    truth = light.residuals(maps)
    off = light.maps(truth).specular / maps.specular
    assert float(off.log().abs().mean()) < 0.02
    stripes = 0.3 * torch.sign(torch.sin(torch.arange(96) * 0.8))  # not slow: those are levels'
    guess = replace(
        truth,
        specular=truth.specular + stripes * metal,
        diffuse=truth.diffuse - 4.6 * metal,
    )
    doubt = torch.full((1, 64, 96), -1.0)
    errors = ExpectedErrors(doubt, doubt, doubt, doubt)
    found = light.maps(refine_albedo(guess, errors, linear, measured, light, metal=metal))
    lit = (slice(None), slice(16, 48), slice(60, 90))
    off = (found.specular / maps.specular).log()[lit].abs().mean()
    assert float(off) < 0.1
    assert float(found.diffuse[lit].mean()) < 0.02
