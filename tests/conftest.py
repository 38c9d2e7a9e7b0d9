"""Settings of all tests."""

import os

import pytest
from hypothesis import HealthCheck, settings

# How fast a busy machine makes examples up is no property of the code under test.
settings.register_profile("matcap", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("matcap")


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """Tests compute little at a time: threads wait for each other, and for what runs beside."""
    yield from _threads(1)


@pytest.fixture
def two_threads():
    """For tests of what threads do."""
    yield from _threads(2)


def _threads(count):
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    yield
    torch.set_num_threads(before)


@pytest.fixture(autouse=True, scope="session")
def no_waiting_for_the_disk():
    """No power is cut here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield
