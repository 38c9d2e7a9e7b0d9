"""Settings of all tests."""

import os

import pytest
from hypothesis import HealthCheck, settings

# How fast a busy machine makes examples up is no property of the code under test.
settings.register_profile("matcap", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("matcap")

# Tests here compute little at a time: threads would only wait for each other.
_ON_ONE_THREAD = ("bench", "capture", "flash", "stability", "statistics")


@pytest.fixture(autouse=True, scope="module")
def one_thread(request):
    if request.path.parent.name not in _ON_ONE_THREAD:
        yield
        return
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(autouse=True, scope="session")
def no_waiting_for_the_disk():
    """No power is cut here but by a disk that stands in for one (failing_disk.py)."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield
