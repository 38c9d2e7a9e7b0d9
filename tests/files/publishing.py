"""Fails every writer at every step, and cuts its power, and looks at what it leaves.

    python tests/files/publishing.py

Each writer puts another version over what stands in a folder. A step fails, or all from it on, or
it is interrupted there; or the power goes, and the disk holds what had reached it. Then, with the
next run come by, the folder holds the one version or the other, whole. test_publishing.py runs a
shorter form.
"""

from __future__ import annotations

import argparse
import random
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from failing_disk import Failing, Recorded, contents, watched
from materials import a_material
from random_maps import random_maps
from small import small_prior

from matcap.batch.record import write_record
from matcap.batch.workspace import open_run
from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.brdf.maps import MapSet
from matcap.capture.outputs import write_outputs
from matcap.capture.result import CaptureResult, Tuning
from matcap.capture.settings import CaptureSettings, OutputSettings
from matcap.capture.verdict.judge import judge
from matcap.capture.verdict.measurements import measure_capture
from matcap.cli.main import main as matcap
from matcap.errors import MatcapError
from matcap.export.job import ExportJob
from matcap.export.targets import write_export
from matcap.field.plane import Rectangle
from matcap.files.publish import recover
from matcap.files.staging import staged
from matcap.photo.photo import Photo
from matcap.synth.request import SynthRequest, Work
from matcap.synth.synthesise import synthesise

Writer = Callable[[Path, int], None]  # a folder, and which version
_SIDE = 32
_MODES = ("once", "lasting", "interrupted")


def _maps(version: int) -> MapSet:
    return random_maps(_SIDE, _SIDE, version)


def plain(folder: Path, version: int) -> None:
    """Files of some names, one of them in the first version alone."""
    with staged(folder, replacing=["old"]) as stage:
        for name in ("a", "b", "c.json", *(["old"] if version == 1 else ["new"])):
            (stage / name).write_text(f"{name} of {version}")


def mapset(folder: Path, version: int) -> None:
    write_mapset(_maps(version), folder, MapSetInfo("m"), png=version == 1)


def synth(folder: Path, version: int) -> None:
    area = Rectangle(0, 0, _SIDE, _SIDE)
    asked = SynthRequest(a_material(), area, version, png=version == 1)
    synthesise(asked, folder, Work(workers=1))


def export(folder: Path, version: int) -> None:
    write_export(ExportJob(_maps(version), "m"), "gltf", folder)


def capture(folder: Path, version: int) -> None:
    settings = OutputSettings((_SIDE, _SIDE), seed=version, png=version == 1)
    write_outputs(_captured(version), folder, settings)


def blend(folder: Path, version: int) -> None:
    ends = []
    for name in "xy":
        ends.append(folder.parent / f"{name}{version}.matcap")
        if not ends[-1].exists():
            a_material(name, seed=version).save(ends[-1])
    code = matcap(["blend", *map(str, ends), "-t", "0:1:2", "-o", str(folder), "-q"])
    if code:
        raise MatcapError(f"exit code {code}")


def prior(folder: Path, version: int) -> None:
    small_prior(version).save(folder / "prior.safetensors")


def batch(folder: Path, version: int) -> None:
    with open_run(folder) as run:
        stage = run.stage("m")
        mapset(stage, version)
        write_record(stage, {"identity": str(version)})
        run.publish(stage)


WRITERS: tuple[Writer, ...] = (plain, mapset, synth, export, capture, blend, prior, batch)


def _captured(version: int) -> CaptureResult:
    pixels = np.full((_SIDE, _SIDE, 3), 0.2 * version, dtype=np.float32)
    photo = Photo(pixels, pixels[..., 0] > 1.0, 45.0, "assumed", False, "p.jpg", (_SIDE, _SIDE))
    material = a_material("m", seed=version)
    seen = measure_capture(photo, material.setup, pixels, pixels, ~photo.clipped)
    return CaptureResult(
        photo, material, pixels, pixels, _maps(version), seen, judge(seen), {"coarse fit": 0.5},
        CaptureSettings(), False, tuning=Tuning(((0.5, 1, 0.9), (1.0, 2, 0.5))),
    )  # fmt: skip


@dataclass
class Bench:
    """A writer, what its versions look like, and where to try it."""

    writer: Writer
    """One of WRITERS."""
    place: Path
    """An empty folder."""

    def __post_init__(self) -> None:
        self.place = self.place.resolve()
        self.out = self.place / "out"
        self.saved = self.place / "saved"
        self.writer(self.out, 1)
        (self.out / "notes.txt").write_text("somebody's own")
        shutil.copytree(self.out, self.saved)
        self.before = contents(self.out)
        counted = Failing()
        with watched(self.out, counted.seen):
            self.writer(self.out, 2)
        self.after, self.steps = contents(self.out), counted.steps
        assert set(self.before) - set(self.after) or self.writer not in (plain, mapset, synth)
        assert self.before != self.after and "notes.txt" in self.after

    def fail(self, at: int, mode: str) -> None:
        """Let the second version fail at a step.

        Raises:
            AssertionError: it left something that is neither version.
        """
        self.begin_anew()
        error = KeyboardInterrupt() if mode == "interrupted" else None
        failing = Failing(at, lasting=mode == "lasting", error=error)
        failed = False
        with watched(self.out, failing.seen):
            try:
                self.writer(self.out, 2)
            except (MatcapError, OSError, KeyboardInterrupt):
                failed = True
        if mode == "lasting":
            self._come_by(self.out)
        self._check(contents(self.out), f"step {at} failed, {mode}", failed)

    def cut(self, chance: random.Random, each: int) -> int:
        """Cut the second version's power after every step; returns how often.

        Raises:
            AssertionError: the disk held something that is neither version, or, when it was
                reported as written, not the second.
        """
        self.begin_anew()
        recorded = Recorded(self.out)
        with watched(self.out, recorded.seen):
            self.writer(self.out, 2)
        found = self.place / "found"
        count = 0
        for step, survivors in recorded.cuts(chance, each):
            shutil.rmtree(found, ignore_errors=True)
            recorded.restore(step, survivors, found)
            self._come_by(found)
            done = step == len(recorded.log)
            self._check(contents(found), f"power cut after step {step}", not done)
            count += 1
        return count

    def begin_anew(self) -> None:
        """Let the first version stand there again."""
        shutil.rmtree(self.out)
        shutil.copytree(self.saved, self.out)

    def _come_by(self, out: Path) -> None:
        """The next run, whatever it then does."""
        if self.writer is batch:
            with open_run(out):
                pass
        recover(out)

    def _check(self, found: dict[str, bytes], result: str, failed: bool) -> None:
        for version in (self.after, self.before)[: 2 if failed else 1]:
            if found == version:
                return
        odd = sorted(
            name
            for name in {*self.before, *self.after, *found}
            if found.get(name) != self.after.get(name)
        )
        raise AssertionError(f"{self.writer.__name__}: {result}: not the new one: {odd}")


def trials(bench: Bench, every: int) -> Iterator[tuple[int, str]]:
    """Each step in each way, or some of them."""
    cases = [(at, mode) for at in range(bench.steps) for mode in _MODES]
    return iter(cases[::every])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--every", type=int, default=1, help="of the failures, each so-manieth")
    parser.add_argument("--cuts", type=int, default=8, help="random states of the disk for a step")
    options = parser.parse_args()
    total = 0
    for writer in WRITERS:
        with tempfile.TemporaryDirectory() as folder:
            bench = Bench(writer, Path(folder))
            failures = 0
            for at, mode in trials(bench, options.every):
                bench.fail(at, mode)
                failures += 1
            cuts = bench.cut(random.Random(0), options.cuts)
        print(f"{writer.__name__}: {failures} failures in {bench.steps} steps, {cuts} power cuts")
        total += failures + cuts
    print(f"{total} in all: each left what was there before, or the new one whole.")


if __name__ == "__main__":
    with suppress(BrokenPipeError):
        main()
