"""Photographs of one piece by a hand-held phone, and one that does not belong."""

import pytest

from matcap.lab.simulate.hand_held import Hand, hold, take_several
from matcap.lab.simulate.photograph import PhoneCamera, as_photo
from matcap.lab.simulate.specimen import EXAMPLES

PHONE = PhoneCamera(width=640, height=480, supersampling=1)


def taken(name, count, seed, first=0):
    """(cameras, photographs) of a material, numbered from `first`."""
    cameras = hold(PHONE, Hand(), count, seed)
    shots = take_several(EXAMPLES[name].realise, PHONE, cameras, Hand(), seed)
    return cameras, [as_photo(s.shot, n, f"{name}_{n}") for n, s in enumerate(shots, first)]


@pytest.fixture(scope="session")
def held():
    """(cameras, photographs) of plaster."""
    return taken("plaster", 3, 5)


@pytest.fixture(scope="session")
def foreign():
    """A photograph of leather."""
    return taken("leather", 1, 6, 9)[1][0]
