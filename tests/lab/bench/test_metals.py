"""What is told of metals' F0, by rows whose answer is known."""

from __future__ import annotations

import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.brdf.metals import METAL_F0
from matcap.lab.bench.metals import metal_row, metals_markdown

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
    row = metal_row("gold", maps(half(blue, 0.06)), truth)
    assert row.brightness == pytest.approx((0.5, 0.5, 0.6))
    mean = float(blue.sum() / GOLD.sum())
    assert row.hue == pytest.approx((0.5 / mean - 1.0, 0.5 / mean - 1.0, 0.6 / mean - 1.0))
    assert (row.rest, row.true_rest) == pytest.approx((0.06, 0.04))
    told = metals_markdown([row], "matcap bench metals gold")
    assert "| gold | 0.50, 0.50, 0.60 |" in told and "| 0.060 / 0.040 |" in told


def test_truth_on_a_finer_grid_and_a_grey_answer() -> None:
    truth = maps(GOLD.expand(-1, 8, 16))
    fine = truth.map(lambda m: m.repeat_interleave(2, -1).repeat_interleave(2, -2))
    row = metal_row("gold", maps(0.7 * torch.ones(1, 8, 16)), fine)
    assert row.rest is None and row.channels == 1
    assert row.true == pytest.approx(METAL_F0["gold"])
    assert "grey" in metals_markdown([row], "")
