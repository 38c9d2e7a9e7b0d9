"""Pools of worker processes, of this machine and of a cluster, and how workers' deaths are told."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pool_jobs import prepare, work

from matcap.batch.run import Machines, Processes
from matcap.errors import MatcapError
from matcap.files.names import Progress


@pytest.fixture
def workers():
    workers = Processes(2, work, prepare)
    yield workers
    workers.close()


def finish(workers, count):
    """Wait for so many jobs to end; their events by job, progress left out."""
    ends = {}
    limit = time.monotonic() + 30.0
    while len(ends) < count and time.monotonic() < limit:
        for event in workers.wait(1.0):
            if event.kind != "progress":
                ends[event.job] = event
    return ends


def test_a_killed_worker_takes_no_other_job_along(workers):
    workers.start("kill")
    workers.start("fine")
    ends = finish(workers, 2)
    assert (ends["kill"].kind, ends["kill"].value) == ("died", -signal.SIGKILL)
    assert ends["fine"].kind == "done"
    workers.start("exit")
    workers.start("again")
    ends = finish(workers, 2)
    assert (ends["exit"].kind, ends["exit"].value) == ("died", 7)
    assert ends["again"].kind == "done" and workers.busy() == 0


def test_close_stops_work_at_once(workers):
    workers.start("sleep")
    began = time.monotonic()
    assert [event.value for event in workers.wait(20.0)] == [Progress("begun", 0.5)]
    workers.close()
    assert workers.busy() == 0 and time.monotonic() - began < 20.0


@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
def test_the_first_worker_of_a_process_is_started_with_signals_blocked():
    """Of a batch: a Ctrl-C in the first worker's imports was reported as its crash."""
    code = (
        "import time, multiprocessing\n"
        "from matcap.files.process import starting_children\n"
        "process = multiprocessing.get_context('spawn').Process(target=time.sleep, args=(60,))\n"
        "with starting_children():\n"
        "    process.start()\n"
        "print(open(f'/proc/{process.pid}/status').read())\n"
        "process.kill()\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    blocked = int(ended.stdout.split("SigBlk:")[1].split()[0], 16)
    assert all(blocked >> (which - 1) & 1 for which in (signal.SIGINT, signal.SIGTERM))


@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
def test_workers_end_when_the_main_process_is_killed():
    code = (
        "import sys; sys.path[:0] = sys.argv[1:]; import pool_jobs as t\n"
        "from matcap.batch.run import Processes\n"
        "if __name__ == '__main__':\n"
        "    workers = Processes(1, t.work, t.prepare)\n"
        "    workers.start('sleep'); workers.wait(20)\n"
        "    worker = next(iter(workers._working.values()))[0]\n"
        "    print(worker._process.pid, flush=True); workers.wait(60)\n"
    )
    main = subprocess.Popen(
        [sys.executable, "-c", code, str(Path(__file__).parent)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    assert main.stdout is not None
    with main.stdout:
        worker = int(main.stdout.readline())
    main.kill()
    main.wait()
    limit = time.monotonic() + 10.0
    while time.monotonic() < limit and _runs(worker):
        time.sleep(0.05)
    assert not _runs(worker)


def _runs(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture(scope="module")
def address():
    distributed = pytest.importorskip("distributed", reason='needs pip install "matcap[cluster]"')
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None,
        protocol="tcp",
    ) as cluster:  # fmt: skip
        yield cluster.scheduler_address


@pytest.mark.filterwarnings("ignore")  # dask's own, about ports and threads
def test_jobs_run_and_lost_ones_are_reported(address):
    workers = Machines(address, work, prepare)
    try:
        assert workers.size == 2
        workers.start("a")
        workers.start("fault")
        ends, limit = {}, time.monotonic() + 30.0
        while len(ends) < 2 and time.monotonic() < limit:
            ends |= {event.job: (event.kind, event.value) for event in workers.wait(1.0)}
        assert ends == {"a": ("done", f"a by {os.getpid()}"), "fault": ("died", 1)}
        assert workers.busy() == 0
    finally:
        workers.close()


def test_without_the_extra_the_remedy_is_its_installation(monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr("matcap.files.process.import_module", missing)
    with pytest.raises(MatcapError, match=r"matcap\[cluster\]"):
        Machines("tcp://127.0.0.1:9", work, prepare)
