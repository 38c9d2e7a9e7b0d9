"""A capture that takes no time, so that the command line can be tested on its own."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from random_maps import random_maps

from matcap.capture import pipeline as capturing
from matcap.capture import run as reading
from matcap.capture.result import CaptureResult, Tuning
from matcap.capture.settings import RunStatus
from matcap.capture.verdict.judge import judge
from matcap.capture.verdict.measurements import measure_capture
from matcap.cli import capture as capturing_command
from matcap.cli.main import main
from matcap.errors import MatcapError
from matcap.flash.geometry import FlashSetup
from matcap.photo.photo import Photo


@dataclass(frozen=True)
class FakeMaterial:
    """What the command line needs of a material."""

    name: str
    texel_size: float = 2.0 / 512
    setup: FlashSetup = field(default_factory=FlashSetup)
    provenance: dict = field(default_factory=lambda: {"made": "up"})
    alignment: int = 16
    generators: tuple = ("example",)
    latent: None = None

    def maps(self, width, height, *, seed=0, x=0, y=0, period=None):
        made = random_maps(width, height, seed, texel_size=self.texel_size)
        return replace(made, periodic=period is not None)

    def save(self, path):
        Path(path).write_text(self.name)


def fake_photo(path: Path) -> Photo:
    """A grey photograph; files of less than three bytes are no photographs."""
    if not path.is_file():
        raise MatcapError("no such file", where=str(path), remedy="check the path")
    if path.stat().st_size < 3:
        raise MatcapError("the file is empty", where=str(path), remedy="copy it again")
    pixels = np.full((48, 64, 3), 0.25, dtype=np.float32)
    clipped = np.zeros((48, 64), dtype=bool)
    return Photo(pixels, clipped, 45.0, "assumed", False, path.name, (64, 48))


@dataclass
class FakePipeline:
    """Records what was asked; can be told to fail or to be interrupted."""

    calls: list = field(default_factory=list)
    interrupt: bool = False
    notes: tuple = ()
    failure: BaseException | None = None

    def load_photo(self, path, *, long_side=None, fov=None, noise=True, white=None, tone=None):
        self.calls.append(SimpleNamespace(path=Path(path), long_side=long_side, fov=fov))
        return replace(fake_photo(Path(path)), notes=self.notes)

    def capture_photo(self, photo, settings, progress=None, method=None, others=(), clock=None):
        if self.failure is not None:
            raise self.failure
        self.calls[-1].settings = settings
        self.calls[-1].others = [other.name for other in others]
        by_example = "solve" if others else "index"
        longest = "fine-tuning" if settings.generator == "decoder" else by_example
        clock = clock or capturing.clock_of(settings, progress, 1 + len(others))
        with clock.stage(longest):
            clock.within(longest, 0.5)
        if self.interrupt:
            clock.status = RunStatus.INTERRUPTED
        material = FakeMaterial(Path(photo.name).stem)
        again = photo.pixels * 0.9
        seen = measure_capture(photo, material.setup, photo.pixels, again, ~photo.clipped)
        tuned = Tuning(((0.5, 1, 0.9), (1.0, 2, 0.5)), self_difference=0.25)
        return CaptureResult(
            photo=photo,
            material=material,
            rectified=photo.pixels,
            rerendered=again,
            maps=random_maps(64, 48, 0),
            measurements=seen,
            verdict=judge(seen),
            stage_seconds={"coarse fit": 0.5, longest: 0.5},
            settings=settings,
            status=clock.status,
            tuning=tuned if settings.generator == "decoder" else None,
        )


@pytest.fixture
def pipeline(monkeypatch) -> FakePipeline:
    """The capture pipeline replaced; the command line and all its files stay real."""
    fake = FakePipeline()
    monkeypatch.setattr(reading, "load_photo", fake.load_photo)
    monkeypatch.setattr(capturing, "capture_photo", fake.capture_photo)
    monkeypatch.setattr(capturing_command, "slowness", lambda: 1.0)  # of any machine
    return fake


@pytest.fixture
def matcap(capsys):
    """Run a command in this process; gives code, out and err, and holds failures to their form."""

    def run(*arguments) -> SimpleNamespace:
        code = main([str(argument) for argument in arguments])
        said = capsys.readouterr()
        assert "Traceback" not in said.err
        return SimpleNamespace(code=code, out=said.out, err=said.err)

    return run


@pytest.fixture
def photo(tmp_path) -> Path:
    """A file that the fake loader takes for a photograph."""
    path = tmp_path / "leather.dng"
    path.write_text("a photograph")
    return path
