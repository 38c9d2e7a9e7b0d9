"""Kills a batch with -9 at a random moment, and looks at what it leaves.

A small shoot of simulated photographs is made into materials once undisturbed. Then a batch is
started and killed with its workers, and started again on the same output until it is complete. At
every kill each file under a final name must be whole, and the complete output must be the
undisturbed one, bit for bit, but for times.
"""

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

from simulated.files import write_jpeg, write_shot
from simulated.materials import piece
from simulated.photographs import PhoneCamera, take

from matcap.cli.main import main
from matcap.flash.geometry import FlashSetup

COMMAND = (sys.executable, "-c", "from matcap.cli.main import run; run()", "batch")
SMALL = ("--preset", "instant", "--detail", "96", "--size", "64", "-j", "1", "-q")
# What differs from run to run: times, memory, and the sizes of files that tell of times.
_TIMES = ("seconds", "stage_seconds", "error_over_time", "peak_bytes", "report.json")


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


def torture(folder: Path, kills: int, photographs: int, seed: int) -> None:
    """Kill so many times; raises AssertionError at the first thing that is not as it should be."""
    shoot, chance = folder / "shoot", random.Random(seed)
    make_shoot(shoot, photographs)
    began = time.monotonic()
    assert main(["batch", *_words(shoot, folder / "undisturbed")]) == 0
    usual = time.monotonic() - began
    truth = contents(folder / "undisturbed")
    assert len({name.split("/")[0] for name in truth}) == photographs
    out = folder / "out"
    for _ in range(kills):
        batch = _batch(shoot, out)
        time.sleep(chance.uniform(0.2, 0.9) * usual)
        os.killpg(batch.pid, signal.SIGKILL)
        batch.wait()
        assert contents(out).items() <= truth.items(), (
            "a file is not as the undisturbed run left it"
        )
    assert main(["batch", *_words(shoot, out)]) == 0
    assert contents(out) == truth, "the output differs from the undisturbed one"
    assert not list(out.glob("*/.matcap-*")), "dead runs were not cleared away"


def _batch(shoot: Path, out: Path) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [*COMMAND, *_words(shoot, out)],
        start_new_session=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )


def _words(shoot: Path, out: Path) -> tuple[str, ...]:
    return (str(shoot), "-o", str(out), *SMALL)


def contents(out: Path) -> dict[str, str]:
    """What each file of the materials holds, by name; of JSON, times are left out."""
    found = {}
    for file in sorted(file for file in out.glob("[!.]*/**/*") if file.is_file()):
        name = file.relative_to(out).as_posix()
        if file.parent.name.startswith("."):  # not of its final name yet
            continue
        if file.name in ("report.json", "matcap-batch.json"):
            document = _timeless(json.loads(file.read_bytes()))
            found[name] = json.dumps(document, sort_keys=True, indent=0)
        else:
            found[name] = hashlib.sha256(file.read_bytes()).hexdigest()
    return found


def _timeless(value: object) -> object:
    if isinstance(value, dict):
        return {key: _timeless(item) for key, item in value.items() if key not in _TIMES}
    return [_timeless(item) for item in value] if isinstance(value, list) else value
