"""Kills a batch with -9 at random moments, again and again, and looks at what it leaves.

A small shoot of simulated photographs is made into materials once undisturbed. Then batches are
started and killed: the whole of it, the main process alone, or one worker; and started again on
the same output until it is complete, then on a new one. At every kill each file under a final name
must be whole, and every complete output must be the undisturbed one, bit for bit, but for times.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from simulated.files import write_jpeg, write_shot
from simulated.materials import piece
from simulated.photographs import PhoneCamera, take

from matcap.flash.geometry import FlashSetup

COMMAND = (sys.executable, "-c", "from matcap.cli.main import run; run()", "batch")
SMALL = ("--preset", "instant", "--detail", "128", "--size", "64")
# What differs from run to run: times, memory, and the sizes of files that tell of times.
_TIMES = ("seconds", "stage_seconds", "error_over_time", "peak_bytes", "report.json")
_PATIENCE = 600.0  # seconds that any batch may take


def make_shoot(folder: Path, count: int) -> None:
    """Photographs of 128 x 96 pixels: leather as DNG and JPEG, the others as JPEGs."""
    camera = PhoneCamera(width=128, height=96, supersampling=1)
    folder.mkdir(parents=True, exist_ok=True)
    for index, name in enumerate(("leather", "granite", "rust", "plaster")[:count]):
        setup = FlashSetup(offset=(0.1, 0.05, 0.0), tilt=(0.02 * index, -0.02))
        shot = take(piece(name, 5 + index), camera, setup)
        write_jpeg(folder / f"{name}.jpg", shot, index)
        if index == 0:
            write_shot(folder / f"{name}.dng", shot, index)


def run_batch(shoot: Path, out: Path, *more: str) -> int:
    """Let a batch go on to its end; its exit code."""
    command = [*COMMAND, str(shoot), "-o", str(out), *SMALL, *more, "-q"]
    return subprocess.run(command, timeout=_PATIENCE, env=_environment()).returncode


def contents(out: Path) -> dict[str, str]:
    """What each file of the materials holds, by name; of JSON, times are left out.

    Raises:
        AssertionError: a JSON file is torn.
    """
    found = {}
    for file in _materials(out):
        name = file.relative_to(out).as_posix()
        try:
            data = file.read_bytes()
        except FileNotFoundError:
            continue  # the folder just made room for its successor
        if file.name in ("report.json", "matcap-batch.json"):
            found[name] = json.dumps(_timeless(json.loads(data)), sort_keys=True, indent=0)
        else:
            found[name] = hashlib.sha256(data).hexdigest()
    return found


@dataclass
class Tally:
    """What was done and seen."""

    kills: int = 0
    complete: int = 0
    runs: int = 0


def torture(folder: Path, kills: int, photographs: int, jobs: int, seed: int) -> Tally:
    """Kill so many times; raises AssertionError at the first thing that is not as it should be."""
    shoot, chance, tally = folder / "shoot", random.Random(seed), Tally()
    make_shoot(shoot, photographs)
    began = time.monotonic()
    assert run_batch(shoot, folder / "undisturbed", "-j", str(jobs)) == 0
    usual = time.monotonic() - began
    truth = contents(folder / "undisturbed")
    assert len({name.split("/")[0] for name in truth}) == photographs
    out = folder / "out-0"
    while tally.kills < kills:
        if set(contents(out)) == set(truth):
            tally.complete += 1
            shutil.rmtree(out)
            out = folder / f"out-{tally.complete}"
        tally.runs += 1
        began = time.monotonic()
        killed = _killed(shoot, out, jobs, chance, usual)
        tally.kills += killed
        _check(out, truth)
        if not killed:
            usual = min(usual, time.monotonic() - began)  # the first one waited for cold files
    assert run_batch(shoot, out, "-j", str(jobs)) == 0
    assert contents(out) == truth, "the output differs from the undisturbed one"
    assert not list(out.glob("*/.matcap-*")), "dead runs were not cleared away"
    tally.complete += 1
    return tally


def _killed(shoot: Path, out: Path, jobs: int, chance: random.Random, usual: float) -> bool:
    """Start a batch and kill it, or part of it; False if it was done before."""
    command = [*COMMAND, str(shoot), "-o", str(out), *SMALL, "-j", str(jobs), "-q"]
    batch = subprocess.Popen(
        command, start_new_session=True, stderr=subprocess.PIPE, env=_environment()
    )
    assert batch.stderr is not None
    with batch.stderr:
        try:
            batch.wait(chance.uniform(0.0, usual))
        except subprocess.TimeoutExpired:
            pass
        else:
            assert batch.returncode == 0, batch.stderr.read().decode()
            return False
        victim = chance.choice(("all", "all", "main", "worker"))
        workers = _children(batch.pid)
        if victim == "worker" and workers:
            os.kill(chance.choice(workers), signal.SIGKILL)
            batch.wait(_PATIENCE)
            # A worker killed twice on one photograph is reported as out of memory.
            assert batch.returncode in (0, 3, 4), batch.stderr.read().decode()
        elif victim == "main":
            batch.kill()
            batch.wait()
        else:
            os.killpg(batch.pid, signal.SIGKILL)
            batch.wait()
    return True


def _check(out: Path, truth: dict[str, str]) -> None:
    """Whatever bears a final name is whole: it is the undisturbed run's, bit for bit."""
    for name, found in contents(out).items():
        if truth.get(name) != found:
            lines = difflib.unified_diff(truth.get(name, "").split("\n"), found.split("\n"), n=0)
            difference = "\n".join(line[:200] for line in lines)
            raise AssertionError(f"{name} is not as the undisturbed run left it:\n{difference}")
    page = out / "index.html"
    if page.exists():
        assert page.read_text().rstrip().endswith("</html>"), "index.html is torn"
        json.loads((out / "index.json").read_text())


def _materials(out: Path) -> Iterator[Path]:
    for folder in sorted(out.glob("*/")):
        if not folder.name.startswith("."):
            whole = (file for file in folder.rglob("*") if file.is_file())
            yield from sorted(file for file in whole if not file.parent.name.startswith("."))


def _timeless(value: object) -> object:
    if isinstance(value, dict):
        return {key: _timeless(item) for key, item in value.items() if key not in _TIMES}
    return [_timeless(item) for item in value] if isinstance(value, list) else value


def _children(pid: int) -> list[int]:
    """Worker processes of a batch (Linux): its children that run the spawned main."""
    found = []
    with suppress(OSError):  # what has ended meanwhile
        for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                found.append(int(child))
    return found


def _environment() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1"}
