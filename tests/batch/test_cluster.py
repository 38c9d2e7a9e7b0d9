"""A workers of dask.distributed workers, in threads of this process."""

import time

import pytest

from matcap.batch.worker_pool import Machines
from matcap.errors import MatcapError
from matcap.files.names import Progress

distributed = pytest.importorskip("distributed", reason='needs pip install "matcap[cluster]"')
pytestmark = pytest.mark.filterwarnings("ignore")  # dask's own, about ports and threads


def work(job, tell):
    tell(Progress("begun", 0.5))
    if job == "fault":
        raise RuntimeError("a lost worker looks like this")
    return f"did {job}"


def prepare():
    pass


@pytest.fixture(scope="module")
def address():
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None,
        protocol="tcp",
    ) as cluster:  # fmt: skip
        yield cluster.scheduler_address


def test_jobs_run_and_lost_ones_are_reported(address):
    workers = Machines(address, work, prepare)
    try:
        assert workers.size == 2
        workers.start("a")
        workers.start("fault")
        ends, limit = {}, time.monotonic() + 30.0
        while len(ends) < 2 and time.monotonic() < limit:
            ends |= {event.job: (event.kind, event.value) for event in workers.wait(1.0)}
        assert ends == {"a": ("done", "did a"), "fault": ("died", 1)}
        assert workers.busy() == 0
    finally:
        workers.close()


def test_without_the_extra_the_remedy_is_its_installation(monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr("matcap.files.process.import_module", missing)
    with pytest.raises(MatcapError, match=r"matcap\[cluster\]"):
        Machines("tcp://127.0.0.1:9", work, prepare)
