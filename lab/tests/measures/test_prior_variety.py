"""Precision and recall of made pictures: what the sets are made of is known."""

import pytest
import torch

from matcap_lab.measures.style import (
    Group,
    RandomFilters,
    describe_pictures,
    difference,
    style_distances,
    variety,
)


def points(values):
    """Statistics of made-up pictures: one group of numbers far from 0, where distances are even."""
    return {"group": Group(100.0 + torch.as_tensor(values, dtype=torch.float32), 0.0)}


def cloud(count, centre, seed):
    generator = torch.Generator().manual_seed(seed)
    return centre + torch.randn(count, 4, generator=generator)


def test_the_same_distribution_has_both():
    found = variety(points(cloud(200, 0.0, 1)), points(cloud(200, 0.0, 2)))
    assert found.precision > 0.9
    assert found.recall > 0.9
    assert found.spread == pytest.approx(1.0, abs=0.1)


def test_one_of_two_modes_is_precise_and_recalls_half():
    true = torch.cat([cloud(100, 0.0, 1), cloud(100, 20.0, 2)])
    found = variety(points(cloud(100, 0.0, 3)), points(true))
    assert found.precision > 0.9
    assert found.recall == pytest.approx(0.5, abs=0.06)
    assert found.spread < 0.4


def test_what_lies_elsewhere_has_neither():
    found = variety(points(cloud(50, 40.0, 1)), points(cloud(50, 0.0, 2)))
    assert (found.precision, found.recall) == (0.0, 0.0)


def test_the_nearest_is_told():
    true = torch.tensor([[0.0], [10.0], [20.0], [30.0], [40.0]])
    made = torch.tensor([[21.0], [1.0], [39.0], [11.0]])
    assert variety(points(made), points(true)).nearest.tolist() == [2, 0, 4, 1]


def test_distances_are_those_of_single_pictures():
    generator = torch.Generator().manual_seed(0)
    pictures = torch.rand(3, 3, 160, 160, generator=generator)
    result = describe_pictures(list(pictures))
    found, style = style_distances(result, result), RandomFilters()
    wanted = float(difference(style(pictures[:1]), style(pictures[2:])))
    assert float(found[0, 2]) == pytest.approx(wanted, rel=1e-4)
    assert float(found.diagonal().abs().max()) < 1e-6
