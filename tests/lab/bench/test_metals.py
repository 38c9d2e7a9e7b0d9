"""What F0 of metals is off by, where the answer is known."""

from __future__ import annotations

import math

import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.brdf.metals import METAL_F0
from matcap.lab.bench.metals import f0_errors

GOLD = torch.tensor(METAL_F0["gold"])[:, None, None]


def maps(specular: torch.Tensor) -> MapSet:
    one = torch.ones(1, 8, 16)
    return MapSet(0.1 * one.expand(3, -1, -1), specular, 0.4 * one, 0.0 * one, 0.1)


def half(metal, rest) -> torch.Tensor:
    """(C, 8, 16): metal on the left, the rest on the right."""
    left = torch.as_tensor(metal).expand(-1, 8, 8)
    return torch.cat([left, torch.full_like(left, rest)], -1)


def test_brightness_hue_and_what_lies_beside_are_told_apart() -> None:
    truth = maps(half(GOLD, 0.04))
    blue = GOLD * torch.tensor([0.5, 0.5, 0.6])[:, None, None]
    values = f0_errors(maps(half(blue, 0.06)), truth)
    colours = ("red", "green", "blue")
    assert [values[name] for name in colours] == pytest.approx([0.5, 0.5, 0.6])
    mean = float(blue.sum() / GOLD.sum())
    hue = [100.0 * (one / mean - 1.0) for one in (0.5, 0.5, 0.6)]
    assert [values[f"{name} hue"] for name in colours] == pytest.approx(hue)
    assert (values["dielectric"], values["true dielectric"]) == pytest.approx((0.06, 0.04))


def test_truth_on_a_finer_grid_and_a_grey_answer() -> None:
    truth = maps(GOLD.expand(-1, 8, 16))
    fine = truth.map(lambda m: m.repeat_interleave(2, -1).repeat_interleave(2, -2))
    values = f0_errors(maps(0.7 * torch.ones(1, 8, 16)), fine)
    assert math.isnan(values["dielectric"]) and math.isnan(values["red hue"])
    assert values["red"] == pytest.approx(0.7 / METAL_F0["gold"][0])
