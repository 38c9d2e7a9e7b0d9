"""Grooves are drawn along a grain that the shape of the highlight shows."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from photographed import photographed

from matcap.capture.piece.grain import across_grain, grooves
from matcap.flash.plane import Plane
from matcap.flash.render import render_flash
from matcap.statistics.encoding import Encoding

HEIGHT, WIDTH = 192, 256
ANGLES = [0.0, 0.5, 1.4, -0.9]


def angle_between(first: float, second: float) -> float:
    """Difference of two directions, radians."""
    return abs(math.remainder(first - second, math.pi))


def photograph(relief: torch.Tensor, grain: torch.Tensor) -> torch.Tensor:
    """Radiance of glossy paint with a relief and a logarithm of albedo, (1, H, W) each."""
    shot = photographed(0.06, 0.0, width=WIDTH, height=HEIGHT)
    one = torch.ones(1, HEIGHT, WIDTH)
    maps = replace(
        shot.maps,
        diffuse=0.05 * grain.exp().expand(3, -1, -1),
        specular=0.04 * one,
        roughness=0.35 * one,
        height=relief * shot.maps.texel_size,
    )
    linear = render_flash(maps, shot.uniform.setup, shot.points)
    return linear / float(linear.quantile(0.995))


def found(relief: torch.Tensor, grain: torch.Tensor) -> float | None:
    """The direction across grooves that a flat, even material lacks."""
    nothing = torch.zeros(1, HEIGHT, WIDTH)
    seen, drawn = photograph(relief, grain), photograph(nothing, nothing)
    valid = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    return across_grain(Plane(seen, valid, None, Encoding(1.0, torch.eye(3))), lambda: drawn)


@pytest.mark.parametrize("across", ANGLES)
def test_grooves_slope_across_themselves(across: float) -> None:
    plane = grooves((HEIGHT, WIDTH), across)[0].numpy()
    down, right = np.gradient(plane)
    assert math.sqrt(np.square(down).mean() + np.square(right).mean()) == pytest.approx(0.06)
    over = np.square(right * math.cos(across) - down * math.sin(across)).mean()
    along = np.square(right * math.sin(across) + down * math.cos(across)).mean()
    assert over > 5.0 * along  # central differences turn short waves


@pytest.mark.parametrize("across", ANGLES)
def test_the_direction_of_a_grain_is_found(across: float) -> None:
    relief = 3.0 * grooves((HEIGHT, WIDTH), across)
    direction = found(relief, relief / relief.std() * 0.1)
    assert direction is not None
    assert angle_between(direction, across) < 0.1


def test_a_long_highlight_without_a_grain_gets_no_grooves() -> None:
    across = 0.3
    rng = np.random.default_rng(3)
    speckle = torch.from_numpy(rng.normal(size=(1, HEIGHT, WIDTH)).astype(np.float32))
    assert found(3.0 * grooves((HEIGHT, WIDTH), across), speckle) is None


def test_a_grain_across_the_wrong_direction_gets_no_grooves() -> None:
    grain = grooves((HEIGHT, WIDTH), 0.3 + math.pi / 2.0)
    relief = 1.5 * grooves((HEIGHT, WIDTH), 0.3)
    assert found(relief, grain / grain.std()) is None


def test_a_photograph_without_valid_texels_gets_no_grooves() -> None:
    relief = 3.0 * grooves((HEIGHT, WIDTH), 0.3)
    seen, drawn = photograph(relief, 0.0 * relief), photograph(0.0 * relief, 0.0 * relief)
    nowhere = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    assert (
        across_grain(Plane(seen, nowhere, None, Encoding(1.0, torch.eye(3))), lambda: drawn) is None
    )


def test_a_round_highlight_gets_no_grooves() -> None:
    grain = grooves((HEIGHT, WIDTH), 0.3)
    assert found(0.0 * grain, 0.1 * grain / grain.std()) is None
