"""Map sets to write."""

import pytest
from exported import MATERIALS
from metals import metals
from random_maps import maps  # noqa: F401
from simulated.materials import realise

from matcap.brdf.maps import MapSet


@pytest.fixture(scope="session")
def made() -> dict[str, MapSet]:
    """Small pieces of procedural materials, and of metals, by name."""
    return metals() | {
        name: realise(name, 48, 32, 1, 2.0 / 48).map(lambda map_: map_.float())
        for name in MATERIALS
    }
