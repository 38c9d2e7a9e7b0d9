"""Photographs of one piece by a hand-held phone, and one that does not belong."""

import pytest
from seen_views import photographed
from simulated.photographs import PhoneCamera

from matcap.capture.registration import keypoints, register

PHONE = PhoneCamera(width=480, height=360, supersampling=1)


@pytest.fixture(scope="session")
def held():
    """(cameras, photographs) of plaster."""
    return photographed("plaster", PHONE, 3, 5)


@pytest.fixture(scope="session")
def foreign():
    """A photograph of leather."""
    return photographed("leather", PHONE, 1, 6, first=9)[1][0]


@pytest.fixture(autouse=True, scope="session")
def keypoints_of_a_photograph_once(remembered):
    """They take as long as all else of a registration, and the same photographs are registered."""
    once = remembered(keypoints.find_keypoints)
    with pytest.MonkeyPatch.context() as patch:
        for module in (keypoints, register):
            patch.setattr(module, "find_keypoints", once)
        yield
