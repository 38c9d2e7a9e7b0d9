"""Map sets to write."""

import pytest
import torch
from exported import MATERIALS

from matcap.brdf.maps import MapSet
from matcap.simulate.materials import realise


@pytest.fixture
def maps() -> MapSet:
    """Random maps, wider than high, with heights on both sides of zero."""
    generator = torch.Generator().manual_seed(1)

    def uniform(channels: int) -> torch.Tensor:
        return torch.rand(channels, 20, 31, generator=generator)

    return MapSet(uniform(3), uniform(1), uniform(1), 0.01 * uniform(1) - 0.003, 2.0 / 512)


@pytest.fixture(scope="session")
def made() -> dict[str, MapSet]:
    """Small pieces of procedural materials, by name."""
    return {
        name: realise(name, 48, 32, 1, 2.0 / 48).map(lambda map_: map_.float())
        for name in MATERIALS
    }
