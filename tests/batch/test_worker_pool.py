"""Worker processes that die, and what the workers says of it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from matcap.batch.worker_pool import Processes
from matcap.files.progress import Progress


def prepare():
    pass


def work(job, tell):
    """Module-level, so that a spawned process finds it."""
    tell(Progress("begun", 0.5))
    if job == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if job == "exit":
        os._exit(7)
    if job == "sleep":
        time.sleep(60.0)
    return f"{job} by {os.getpid()}"


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
def test_workers_end_when_the_main_process_is_killed():
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); import test_worker_pool as t\n"
        "if __name__ == '__main__':\n"
        "    workers = t.Processes(1, t.work, t.prepare)\n"
        "    workers.start('sleep'); workers.wait(20)\n"
        "    worker = next(iter(workers._working.values()))[0]\n"
        "    print(worker._process.pid, flush=True); workers.wait(60)\n"
    )
    folder = str(Path(__file__).parent)
    main = subprocess.Popen(
        [sys.executable, "-c", code, folder], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
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
