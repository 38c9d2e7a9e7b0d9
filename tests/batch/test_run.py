"""A batch's scheduling, its workers and their crashes."""

import errno
import json
import os
import signal
import sys

import cv2
import numpy as np
import pytest
from kills import torture

import matcap.batch.run
from matcap.batch.run import Batch, Event, Prepared, exit_code
from matcap.batch.samples import BatchSettings, Policy, find_samples
from matcap.batch.work import Failure, do_job, make_plan, open_run, recorded
from matcap.capture import run as capture_run
from matcap.cli.main import main
from matcap.files.names import Progress
from matcap.files.output import Output

# The order of events of a batch, with a workers that does what it is told.

SETTINGS = BatchSettings.of({"detail": 512, "size": (64, 64)})


class FakeWorkers:
    """Answers every job by `answer(job)`: a failure, an exit code, or True for a material."""

    def __init__(self, answer, size=2):
        self.size, self.answer, self.jobs, self.open, self.closed = size, answer, [], [], False
        self.most = 0

    def busy(self):
        return len(self.open)

    def start(self, job):
        self.jobs.append(job)
        self.open.append(job)
        self.most = max(self.most, len(self.open))
        assert not job.alone or len(self.open) == 1

    def wait(self, seconds):
        job = self.open.pop(0)
        result = [Event(job, "progress", Progress("fine-tuning", 0.5))]
        answer = self.answer(job)
        if isinstance(answer, int) and not isinstance(answer, bool):
            return [*result, Event(job, "died", answer)]
        if isinstance(answer, Failure):
            return [*result, Event(job, "done", answer)]
        folder = job.out / job.name
        with recorded(folder, {"identity": job.identity, "name": job.name}):
            write(folder, "preview.png", "made")
        return [*result, Event(job, "done", {"name": job.name, "doubtful": False})]

    def close(self):
        self.open, self.closed = [], True


class Watcher:
    def __init__(self):
        self.notes, self.ends = [], []

    def expect(self, total):
        pass

    def started(self, entry):
        pass

    def progress(self, entry, now):
        assert 0.0 <= now.fraction <= 1.0

    def ended(self, entry):
        self.ends.append((entry.sample.name, entry.state))

    def note(self, sentence):
        self.notes.append(sentence)


@pytest.fixture
def shoot(tmp_path):
    folder = tmp_path / "shoot"
    folder.mkdir()
    for name in "abcd":
        (folder / f"{name}.jpg").write_text(name)
    return folder


@pytest.fixture
def batch(shoot, tmp_path):
    """Run a batch whose workers answers so; gives entries, workers and watcher."""

    def go(answer=lambda job: True, policy=None, size=2, settings=SETTINGS):
        policy, workers, watcher = policy or Policy(), FakeWorkers(answer, size), Watcher()
        prepared = plan(shoot, tmp_path / "out", policy, settings)
        with open_run(tmp_path / "out"):
            Batch(prepared, workers, policy, watcher).go()
        return prepared.entries, workers, watcher

    return go


def plan(shoot, out, policy, settings=SETTINGS):
    entries = make_plan(find_samples(shoot), out, settings, policy, prior="p")
    return Prepared(out, settings, entries, 1, 2)


def write(folder, name, text):
    """As captures write: the file under the name is another one."""
    with Output.file(folder / name) as file:
        file.write_text(text)


def states(entries):
    return {entry.sample.name: entry.state for entry in entries}


def bad(name, kind="photograph"):
    return lambda job: Failure(kind, f"{job.name} is bad.") if job.name == name else True


def test_finished_materials_are_kept_by_the_next_run(batch):
    entries, workers, _ = batch()
    assert set(states(entries).values()) == {"made"} and workers.most == 2
    assert exit_code(entries) == 0
    entries, workers, _ = batch()
    assert set(states(entries).values()) == {"kept"} and not workers.jobs
    entries, workers, _ = batch(policy=Policy(force=True))
    assert set(states(entries).values()) == {"made"}


def test_only_changed_photographs_are_captured_again(batch, shoot, tmp_path):
    batch()
    (shoot / "b.jpg").write_text("changed")
    (tmp_path / "out/c/preview.png").unlink()
    entries, workers, _ = batch()
    assert sorted(job.name for job in workers.jobs) == ["b", "c"]
    entries, workers, _ = batch(settings=BatchSettings.of(SETTINGS.named() | {"seed": 1}))
    assert len(workers.jobs) == 4


def test_the_others_go_on_after_a_failure_which_is_remembered(batch):
    entries, _, _ = batch(bad("b"))
    assert states(entries) == {"a": "made", "b": "failed", "c": "made", "d": "made"}
    assert exit_code(entries) == 4 and entries[1].reason == "b is bad."
    entries, workers, _ = batch()
    assert not workers.jobs and entries[1].reason == "b is bad." and exit_code(entries) == 4
    entries, workers, _ = batch(policy=Policy(retry_failed=True))
    assert [job.name for job in workers.jobs] == ["b"] and exit_code(entries) == 0
    entries, workers, _ = batch()
    assert not workers.jobs and exit_code(entries) == 0


def test_a_crash_is_reported_and_tried_again_next_time(batch):
    entries, _, _ = batch(bad("b", "crash"))
    assert exit_code(entries) == 4
    entries, workers, _ = batch()
    assert [job.name for job in workers.jobs] == ["b"]


def test_a_batch_without_a_success_exits_with_3(batch):
    entries, _, _ = batch(lambda job: Failure("photograph", "bad."))
    assert exit_code(entries) == 3


def test_fail_fast_ends_at_the_first_failure(batch):
    entries, workers, _ = batch(bad("a"), Policy(fail_fast=True))
    assert workers.closed and states(entries)["a"] == "failed"
    assert "left" in states(entries).values() and exit_code(entries) in (3, 4)


def test_out_of_memory_is_tried_alone_then_smaller_then_reported(batch):
    entries, workers, watcher = batch(bad("b", "memory"))
    tries = [(job.detail, job.alone) for job in workers.jobs if job.name == "b"]
    assert tries == [(512, False), (512, True), (256, True)]
    assert states(entries) == {"a": "made", "b": "failed", "c": "made", "d": "made"}
    assert any("256" in note for note in watcher.notes)


def test_a_worker_killed_by_the_system_counts_as_out_of_memory(batch):
    def answer(job):
        return -9 if job.name == "c" and job.detail == 512 else True

    entries, workers, _ = batch(answer)
    assert [(j.detail, j.alone) for j in workers.jobs if j.name == "c"][-1] == (256, True)
    assert exit_code(entries) == 0
    entries, workers, _ = batch()  # done, though smaller: the record has the identity asked for
    assert not workers.jobs


def test_a_worker_that_crashes_is_tried_once_more(batch):
    entries, workers, _ = batch(lambda job: -11 if job.name == "c" else True)
    assert [job.alone for job in workers.jobs if job.name == "c"] == [False, True]
    assert states(entries)["c"] == "failed" and "signal 11" in entries[2].reason


def test_a_full_disk_ends_the_batch_and_the_next_goes_on(batch):
    entries, workers, watcher = batch(bad("b", "disk"), size=1)
    assert states(entries) == {"a": "made", "b": "failed", "c": "left", "d": "left"}
    assert any("Free some space" in note for note in watcher.notes)
    entries, workers, _ = batch()
    assert [job.name for job in workers.jobs] == ["b", "c", "d"] and exit_code(entries) == 0


def test_a_full_disk_is_noticed_before_a_capture_starts(batch, monkeypatch):
    from collections import namedtuple

    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr("matcap.batch.run.shutil.disk_usage", lambda path: usage(9, 9, 0))
    entries, workers, _ = batch()
    assert not workers.jobs and set(states(entries).values()) == {"left"}


@pytest.mark.parametrize(
    ("signals", "second"),
    [((signal.SIGINT,), "made"), ((signal.SIGINT,) * 2, "left"), ((signal.SIGTERM,), "left")],
)
def test_the_first_interrupt_finishes_what_runs_and_the_second_ends_it(
    shoot, tmp_path, signals, second
):
    class Interrupted(FakeWorkers):
        def start(self, job):
            super().start(job)
            for number in signals if job.name == "b" else ():
                signal.raise_signal(number)

    workers = Interrupted(lambda job: True, size=1)
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    prepared = plan(shoot, tmp_path / "out", Policy())
    with open_run(tmp_path / "out"), pytest.raises(KeyboardInterrupt):
        Batch(prepared, workers, Policy(), Watcher()).go()
    signal.signal(signal.SIGINT, handler)
    assert workers.closed and (tmp_path / "out/index.html").is_file()
    assert states(prepared.entries) == {"a": "made", "b": second, "c": "left", "d": "left"}


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (MemoryError(), "memory"),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory: 8 bytes"), "memory"),
        (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), "disk"),
        (ValueError("a bug"), "crash"),
    ],
)
def test_every_exception_of_a_worker_is_returned_as_a_failure(batch, monkeypatch, error, kind):
    def fail(*args, **kwargs):
        raise error

    monkeypatch.setattr(capture_run, "load_photo", fail)
    _, workers, _ = batch()
    failure = do_job(workers.jobs[0], lambda now: None)
    assert failure.kind == kind and failure.sentence.endswith(".")


@pytest.mark.capture
def test_a_record_has_the_detail_asked_for_and_says_once_what_is_clipped(batch, shoot, tmp_path):
    """Not in verdict, report and check of the photograph, each in its own words."""
    y, x = np.mgrid[:96, :128] - np.array([[[48.0]], [[64.0]]])
    texture = 1.0 + 0.2 * np.random.default_rng(1).standard_normal((96, 128, 1))
    light = (0.2 + 9.0 * np.exp(-(y**2 + x**2) / 300.0))[..., None] * texture
    cv2.imwrite(str(shoot / "a.jpg"), np.uint8(np.clip(255.0 * light**0.45, 0, 255)).repeat(3, 2))
    settings = BatchSettings.of({"detail": 256, "size": (64, 64), "preset": "instant"})
    _, workers, _ = batch(settings=settings)
    record = do_job(workers.jobs[0], lambda now: None)
    # Forecasts go by the most detail that was asked for: a small photograph has less.
    assert record["most_detail"] == 256
    clipped = [line for line in record["warnings"] if "stops darker" in line]
    assert len(clipped) == 1 and "photograph is clipped" in clipped[0]
    report = json.loads((tmp_path / "out" / "a" / "report.json").read_text())
    assert record["inspection"][0]["clipped"]["message"] in clipped[0]
    assert report["photograph"]["clipped_share"] > 0.08


def test_a_shorter_capture_replaces_a_longer_one_only_if_asked(shoot, tmp_path):
    out = tmp_path / "out"
    (out / "a").mkdir(parents=True)
    (out / "b").mkdir()
    long = {"preset": "standard", "steps": 0, "detail": 4096}
    for name, effort in (("a", long), ("b", {**long, "detail": 64})):
        report = {"format": "matcap report", "interrupted": False, "effort": effort}
        (out / name / "report.json").write_text(json.dumps(report))

    def planned(**choice):
        return {one.sample.name: one for one in plan(shoot, out, Policy(**choice)).entries}

    kept = planned()
    assert kept["a"].state == "failed" and kept["b"].state == "todo"
    assert (
        "a longer one, of preset standard" in kept["a"].reason and "--overwrite" in kept["a"].reason
    )
    report |= {"several": {"photographs": [{"name": name} for name in "bcd"]}}
    (out / "b" / "report.json").write_text(json.dumps(report))
    assert "one of 3 photographs" in planned()["b"].reason
    assert planned(force=True)["a"].state == "failed"
    assert planned(overwrite=True)["a"].state == "todo"


@pytest.mark.capture
@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
def test_a_killed_batch_resumes_to_the_same_files(tmp_path):
    """`torture` of kills.py kills more often than once, too."""
    torture(tmp_path, kills=1, photographs=2, seed=2)


def test_an_interrupt_after_the_last_material_is_reported(tmp_path, monkeypatch, capsys):
    shoot = tmp_path / "shoot"
    shoot.mkdir()
    cv2.imwrite(str(shoot / "a.jpg"), np.full((96, 128, 3), 128, np.uint8))

    def done(prepared, policy, shown, scheduler):
        for entry in prepared.entries:
            entry.state = "made"
        raise KeyboardInterrupt

    monkeypatch.setattr(matcap.batch.run, "work_off", done)
    assert main(["batch", str(shoot), "-o", str(tmp_path / "out")]) == 130
    said = capsys.readouterr().err
    assert "1 made" in said and "matcap: interrupted after the last sample was finished." in said
