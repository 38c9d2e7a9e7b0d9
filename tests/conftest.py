"""Settings of all tests."""

import hashlib
import os
import pickle

import pytest
from hypothesis import HealthCheck, settings

from matcap.files.process import keep_memory

# Of every library and process, before any is loaded: threads of small tests wait for each other,
# and for the other processes of pytest-xdist.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# As in matcap's own processes: clearing pages that were returned took a tenth of the tests' time.
keep_memory()

# How fast a busy machine makes examples up is no property of the code under test.
settings.register_profile("matcap", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("matcap")


@pytest.fixture
def two_threads():
    """For tests of what threads do."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def remembered():
    """Of a slow function one that computes once for equal arguments."""

    def of(function):
        known = {}

        def once(*given, **named):
            asked = hashlib.sha256(pickle.dumps((given, named))).digest()
            if asked not in known:
                known[asked] = function(*given, **named)
            return known[asked]

        return once

    return of


@pytest.fixture(scope="module")
def one_coarse_fit(remembered):
    """A coarse fit, half a second, is made once for all captures of the same photograph."""
    from matcap.capture import rectified

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rectified, "fit_coarse", remembered(rectified.fit_coarse))
        yield


@pytest.fixture(autouse=True, scope="session")
def no_waiting_for_the_disk():
    """No power is cut here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield
