"""Maps of random numbers, as a fixture too."""

import pytest
import torch

from matcap.brdf.maps import MapSet


def random_maps(width, height, seed=1, *, texel_size=None, channels=1, low=0.0, high=1.0):
    """Maps from `low` to `high`, heights a hundredth of it; by default 2 plane units wide."""
    generator = torch.Generator().manual_seed(seed)
    stack = low + (high - low) * torch.rand(5 + channels, height, width, generator=generator)
    stack[-1] *= 0.01
    return MapSet.from_stacked(stack, texel_size or 2.0 / width)


def steepness(maps: MapSet) -> float:
    """Root mean square slope."""
    normal = maps.normal
    return float((normal[:2].square().sum(0) / normal[2].square()).mean().sqrt())


@pytest.fixture
def maps() -> MapSet:
    """Random maps, wider than high, with heights on both sides of zero."""
    made = random_maps(31, 20, texel_size=2.0 / 512)
    return MapSet(made.diffuse, made.specular, made.roughness, made.height - 0.003, 2.0 / 512)
