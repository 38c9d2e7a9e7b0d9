"""A small material, to run what the pages show with."""

import pytest
from materials import SMALL, a_material


@pytest.fixture(scope="session")
def small():
    """An untrained material of the right form."""
    return a_material("leather", config=SMALL, across=256)
