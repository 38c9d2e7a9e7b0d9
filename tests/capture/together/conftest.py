"""Photographs of one piece by a hand-held phone, and one that does not belong."""

import pytest

from matcap.lab.simulate.hand_held import Hand, hold, take_several
from matcap.lab.simulate.photograph import PhoneCamera, as_photo
from matcap.lab.simulate.specimen import EXAMPLES

PHONE = PhoneCamera(width=640, height=480, supersampling=1)
HAND = Hand()


@pytest.fixture(scope="session")
def held():
    """(cameras, photographs) of plaster."""
    assert "plaster" in EXAMPLES
    plaster = EXAMPLES["plaster"]
    cameras = hold(PHONE, HAND, 3, 5)
    shots = take_several(plaster.realise, PHONE, cameras, HAND, 5)
    return cameras, [as_photo(one.shot, n, f"plaster_{n}") for n, one in enumerate(shots)]


@pytest.fixture(scope="session")
def foreign():
    """A photograph of leather."""
    leather = EXAMPLES["leather"]
    cameras = hold(PHONE, HAND, 1, 6)
    (shot,) = take_several(leather.realise, PHONE, cameras, HAND, 6)
    return as_photo(shot.shot, 9, "leather_9")
