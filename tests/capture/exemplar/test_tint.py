"""Metal's colour in a set: taken off and put back, and the same light either way."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.tint import achromatic, coloured, on_grid
from matcap.flash.geometry import FlashSetup
from matcap.flash.render import render_rectified

COPPER = torch.tensor([0.955, 0.638, 0.538])[:, None, None]


def rusty() -> MapSet:
    """Rust beside copper."""
    draw = torch.Generator().manual_seed(2)
    tone = 0.5 + torch.rand(1, 24, 32, generator=draw)
    metal = (torch.arange(32) >= 16).float().expand(1, 24, 32)
    rust = torch.tensor([0.22, 0.085, 0.03])[:, None, None]
    return MapSet(
        (0.6 * rust * tone * (1.0 - metal) + 0.002).expand(3, 24, 32),
        0.04 * (1.0 - metal) + 0.6 * COPPER * tone * metal,
        torch.full((1, 24, 32), 0.4),
        0.002 * tone,
        2.0 / 32,
    )


@pytest.fixture(scope="module")
def grey_and_hue() -> tuple[MapSet, Tensor]:
    """Rust beside copper without its hue."""
    grey, hue = achromatic(rusty())
    assert len(grey.specular) == 1
    return grey, hue


def test_what_is_taken_off_is_put_back(grey_and_hue) -> None:
    back = coloured(*grey_and_hue)
    assert torch.allclose(back.stacked(), rusty().stacked(), rtol=1e-3, atol=1e-5)


def test_grey_maps_are_left_alone() -> None:
    maps = rusty()
    grey = replace(maps, specular=maps.specular[:1])
    same, hue = achromatic(grey)
    assert torch.equal(hue, torch.ones(1, 24, 32))
    for unchanged in (same, coloured(grey, hue)):
        assert torch.equal(unchanged.stacked(), grey.stacked())


def test_a_photograph_less_its_hue_is_one_of_grey_metal(grey_and_hue) -> None:
    grey, hue = grey_and_hue
    whole, less = (render_rectified(maps, FlashSetup(fov=45.0)).log() for maps in (rusty(), grey))
    assert float((whole - hue.log() - less).abs().max()) < 0.01  # what Schlick adds


def test_hue_follows_the_grid(grey_and_hue) -> None:
    _, hue = grey_and_hue
    fine = on_grid(hue, (64, 48))
    assert fine.shape == (3, 48, 64)
    assert torch.allclose(fine[:, 20, 60], hue[:, 10, 30], rtol=0.02)
