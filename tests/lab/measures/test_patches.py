"""Sliced Wasserstein distances of patches."""

import pytest
import torch

from matcap.lab.measures.style import Patches, difference


def apart(first, second):
    style = Patches()
    return float(difference(style(first), style(second)).mean())


def noise(seed, scale=1.0):
    generator = torch.Generator().manual_seed(seed)
    return (0.5 + 0.1 * scale * torch.randn(2, 3, 96, 96, generator=generator)).clamp(0.0, 1.0)


def test_equal_pictures_are_0_apart_and_it_is_symmetric():
    first, second = noise(0), noise(1, 2.0)
    assert apart(first, first) == 0.0
    assert apart(first, second) == pytest.approx(apart(second, first))


def test_where_patches_are_does_not_count_and_how_often_they_occur_does():
    first = noise(0)
    moved = apart(first, first.roll((13, 29), (2, 3)))
    assert moved < 0.3 * apart(first, noise(1, 2.0))
    assert moved < 0.3 * apart(first, first + 0.1)


def test_grain_is_told_from_blotches_of_the_same_contrast():
    blotches = torch.nn.functional.avg_pool2d(torch.nn.functional.pad(noise(2), [2] * 4), 5, 1)
    blotches = 0.5 + (blotches - 0.5) * 0.1 / float(blotches.std())
    assert apart(noise(0), blotches) > 3.0 * apart(noise(0), noise(1))


def test_small_pictures_are_refused():
    with pytest.raises(ValueError, match="too small"):
        Patches()(torch.zeros(1, 3, 40, 40))
