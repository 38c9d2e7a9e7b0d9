"""Maps of random numbers, as a fixture."""

import pytest
import torch

from matcap.brdf.maps import MapSet


@pytest.fixture
def maps() -> MapSet:
    """Random maps, wider than high, with heights on both sides of zero."""
    generator = torch.Generator().manual_seed(1)

    def uniform(channels: int) -> torch.Tensor:
        return torch.rand(channels, 20, 31, generator=generator)

    return MapSet(uniform(3), uniform(1), uniform(1), 0.01 * uniform(1) - 0.003, 2.0 / 512)
