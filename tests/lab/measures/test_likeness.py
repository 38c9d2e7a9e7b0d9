"""Colours by XYZ histograms, and how unlike realisations are."""

import pytest
import torch

from matcap.lab.measures.paper_metrics import BINS, diversity, xyz_difference, xyz_histograms
from matcap.lab.simulate.write_dng import REC709_TO_XYZ


def picture(seed: int, size: int = 64) -> torch.Tensor:
    return torch.rand(3, size, size, generator=torch.Generator().manual_seed(seed))


def test_the_matrix_takes_white_to_d65():
    # x = 0.3127, y = 0.3290 (IEC 61966-2-1, table 1)
    x, y, z = REC709_TO_XYZ.sum(axis=1)
    assert y == pytest.approx(1.0)
    assert (x / (x + y + z), y / (x + y + z)) == pytest.approx((0.3127, 0.3290), abs=1e-4)


def test_histograms_are_shares():
    shares = xyz_histograms(picture(0))
    assert shares.shape == (3, BINS)
    assert shares.sum(axis=1) == pytest.approx(1.0)
    black, white = xyz_histograms(torch.zeros(3, 4, 4)), xyz_histograms(torch.ones(3, 4, 4))
    assert (black[:, 0] == 1.0).all()
    assert (white[:, -1] == 1.0).all()


def test_a_picture_has_its_own_colours_in_any_order():
    one = picture(1)
    order = torch.randperm(64 * 64, generator=torch.Generator().manual_seed(2))
    shuffled = one.flatten(1)[:, order].reshape(one.shape)
    assert xyz_difference(one, one) == 0.0
    assert xyz_difference(one, shuffled) == 0.0


def test_other_colours_are_apart_either_way_round():
    one = 0.5 * picture(3)
    redder = one * torch.tensor([1.5, 1.0, 1.0])[:, None, None]
    apart = xyz_difference(one, redder)
    assert 0.05 < apart < 1.0
    assert xyz_difference(redder, one) == apart
    assert xyz_difference(torch.zeros(3, 8, 8), torch.ones(3, 5, 5)) == 1.0


def test_the_same_picture_again_is_no_diversity():
    assert diversity(torch.stack([picture(4)] * 3)) == 0.0
    assert diversity(picture(4)[None]) == 0.0
    assert diversity(torch.zeros(2, 3, 64, 64)) == 0.0


def test_diversity_sees_places_more_than_faint_noise():
    one = picture(5)
    moved = one.roll((13, 29), dims=(-1, -2))
    noisy = one + 0.02 * torch.randn(one.shape, generator=torch.Generator().manual_seed(6))
    assert diversity(torch.stack([one, moved])) > 10.0 * diversity(torch.stack([one, noisy]))


def test_diversity_is_the_mean_over_pairs():
    one, two, three = picture(7), picture(8), picture(9)
    pairs = [diversity(torch.stack(pair)) for pair in ((one, two), (one, three), (two, three))]
    assert diversity(torch.stack([one, two, three])) == pytest.approx(sum(pairs) / 3.0)
