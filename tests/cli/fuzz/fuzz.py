"""Feeds spoilt files to every reader: a MatcapError or a good result, and nothing else.

    python tests/cli/fuzz/fuzz.py --count 20000
    python tests/cli/fuzz/fuzz.py --count 5000 --kinds foreign picture mask

A reader fails when anything but a MatcapError of one line escapes, when it takes over 10 seconds,
when the process grows over 2 GB, or dies. Inputs that fail are kept (--keep) under their number;
`--seed` and the number make them again. test_fuzz.py runs a shorter form.
"""

from __future__ import annotations

import argparse
import random
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from inputs import spoil, write_inputs

from matcap.batch.samples import BatchSettings, read_settings
from matcap.batch.work import FILE, is_done, read_record
from matcap.batch.worker_pool import Processes
from matcap.brdf.folder import read_mapset
from matcap.errors import MatcapError
from matcap.field.material import Material
from matcap.files.environment import read_picture
from matcap.files.exr import read_exr
from matcap.files.names import Note, OnProgress
from matcap.files.pixels import read_mask
from matcap.photo.load import load_photo
from matcap.relight.foreign.read import read_foreign
from matcap.relight.scenefile import read_scene

LONGEST = 10.0  # seconds
LARGEST = 2 << 30  # bytes
# How often each kind comes up.
_WEIGHTS = {
    "photo": 10, "exr": 3, "picture": 2, "material": 5, "mapset": 2, "scene": 3, "settings": 3,
    "record": 1, "foreign": 3, "mask": 1,
}  # fmt: skip


@dataclass(frozen=True)
class Input:
    """A spoilt file and what reads it."""

    number: int
    kind: str
    path: Path


@dataclass(frozen=True)
class Fault:
    """An input that was not borne, and how it showed."""

    number: int
    kind: str
    path: Path
    what: str


def read(job: Input, tell: OnProgress) -> tuple[str, str]:
    """Read an input, in a worker: ("good" or "refused" or "fault", details)."""
    try:
        _READERS[job.kind](job.path)
    except MatcapError as error:
        sentence = str(error)
        plain = "\n" not in sentence and "Traceback" not in sentence and error.what
        if not plain:
            return "fault", f"a sentence of several lines: {sentence!r}"
        result, detail = "refused", sentence
    except Exception:
        return "fault", traceback.format_exc(limit=-6)
    else:
        result, detail = "good", ""
    held = most_held()
    return (result, detail) if held < LARGEST else ("fault", f"{held / 1e9:.1f} GB of memory")


def most_held() -> int:
    """Bytes this process held at most; getrusage counts what its parent held at its birth."""
    status = Path("/proc/self/status")
    if not status.is_file():  # macOS counts in bytes
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    held = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM:"))
    return int(held.split()[1]) * 1024


def prepare() -> None:
    """Once a worker: one thread, and a bound on memory."""
    warnings.simplefilter("error")  # what a user would see on the terminal is a fault, too
    warnings.simplefilter("ignore", Note)
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    # Beyond this the machine itself would be in danger; torch alone reserves a few.
    resource.setrlimit(resource.RLIMIT_AS, (16 << 30, 16 << 30))


def _photo(path: Path) -> None:
    photo = load_photo(path, long_side=64)
    assert np.isfinite(photo.pixels).all() and photo.pixels.min() >= 0.0
    assert photo.pixels.shape[1] >= photo.pixels.shape[0] and 0.0 < photo.fov < 180.0


def _picture(path: Path) -> None:
    picture = read_picture(path)
    assert picture.shape[2] == 3 and np.isfinite(picture).all() and picture.min() >= 0.0


def _foreign(path: Path) -> None:
    texture = read_foreign(path.parent).texture
    for kind in ("diffuse", "specular", "roughness", "height", "slopes"):
        values = getattr(texture, kind)
        assert np.isfinite(values).all() and values.shape[1:] == texture.height.shape[1:], kind
        assert kind in ("height", "slopes") or 0.0 <= values.min() <= values.max() <= 1.0, kind


def _mask(path: Path) -> None:
    mask = read_mask(path)
    assert mask.ndim == 2 and 0.0 <= mask.min() <= mask.max() <= 1.0


def _material(path: Path) -> None:
    material = Material.load(path)
    assert Path(material.name).name == material.name and len(material.name) < 200
    material.maps(16, 16)


def _settings(path: Path) -> None:
    settings = BatchSettings.of(read_settings(path))
    assert settings.capture.most_detail >= 64 and settings.outputs.room > 0


def _record(path: Path) -> None:
    path.rename(path.with_name(FILE))
    read_record(path.parent)
    is_done(path.parent, "i")


_READERS = {
    "photo": _photo, "exr": read_exr, "picture": _picture, "material": _material,
    "mapset": read_mapset, "scene": read_scene, "settings": _settings, "record": _record,
    "foreign": _foreign, "mask": _mask,
}  # fmt: skip


def fuzz(
    folder: Path, count: int, seed: int, weights: Mapping[str, int] = _WEIGHTS
) -> tuple[Counter[str], list[Fault]]:
    """How many inputs were good, refused and faults; and the faults, whose files are kept."""
    good = folder / "good"
    good.mkdir(parents=True)
    files = write_inputs(good)
    data = {path: path.read_bytes() for paths in files.values() for path in paths}
    tally: Counter[str] = Counter()
    faults: list[Fault] = []
    workers = Processes(1, read, prepare)
    try:
        for number in range(count):
            chance = random.Random(f"{seed} {number}")
            kind = chance.choices(list(weights), list(weights.values()))[0]
            source = chance.choice(files[kind])
            others = [data[path] for path in files[kind]]
            place = folder / "spoilt" / str(number)
            place.mkdir(parents=True)
            if kind in ("mapset", "foreign"):  # its pictures stand beside it
                for other in source.parent.iterdir():
                    (place / other.name).symlink_to(other)
                (place / source.name).unlink()
            path = place / source.name
            path.write_bytes(spoil(data[source], kind, others, chance))
            limit = LONGEST + 50.0 * (number == 0)  # the first one waits for the imports, too
            result, detail = outcome(workers, Input(number, kind, path), limit)
            tally[result] += 1
            tally[f"{kind} {result}"] += 1
            if result == "fault":
                faults.append(Fault(number, kind, path, detail))
            else:
                for other in place.iterdir():
                    other.unlink()
                place.rmdir()
    finally:
        workers.close()
    return tally, faults


def outcome(workers: Processes, job: object, longest: float) -> tuple[str, str]:
    """What a worker answers to a job; a fault where it does not in so many seconds, or dies."""
    workers.start(job)
    limit = time.monotonic() + longest
    while time.monotonic() < limit:
        for event in workers.wait(limit - time.monotonic()):
            if event.kind == "died":
                return "fault", f"the process died with code {event.value}"
            if event.kind == "done":
                return event.value
    workers.close()
    return "fault", f"no answer in {longest:.0f} s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", default=list(_WEIGHTS), choices=list(_WEIGHTS))
    parser.add_argument("--keep", type=Path, help="where inputs that fail are kept")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="matcap-fuzz-") as temporary:
        folder = options.keep or Path(temporary)
        began = time.monotonic()
        tally, faults = fuzz(
            folder, options.count, options.seed, {kind: _WEIGHTS[kind] for kind in options.kinds}
        )
    for fault in faults:
        print(f"{fault.number} ({fault.kind}, {fault.path}): {fault.what}", file=sys.stderr)
    for name, number in sorted(tally.items()):
        print(f"{number:8d}  {name}")
    print(f"{options.count} inputs in {time.monotonic() - began:.0f} s, {len(faults)} faults")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
