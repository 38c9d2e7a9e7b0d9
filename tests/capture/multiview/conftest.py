"""Photographs of one piece by a hand-held phone, and one that does not belong."""

import pytest
from seen_views import photographed
from simulated.photographs import PhoneCamera

PHONE = PhoneCamera(width=480, height=360, supersampling=1)


@pytest.fixture(scope="session")
def held():
    """(cameras, photographs) of plaster."""
    return photographed("plaster", PHONE, 3, 5)


@pytest.fixture(scope="session")
def foreign():
    """A photograph of leather."""
    return photographed("leather", PHONE, 1, 6, first=9)[1][0]
