"""`matcap-lab bench profile`: what each stage of a capture costs, by preset.

Every capture runs in its own process, this module's: wall seconds are those of its CaptureClock;
processor seconds and memory are read as its progress enters and leaves a stage.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

from matcap.capture.settings import (
    EXEMPLAR_STAGES,
    PRESETS,
    CaptureProgress,
    CaptureSettings,
    OutputSettings,
)
from matcap.errors import MatcapError
from matcap.files.process import keep_memory
from matcap_lab.experiment.runner import Configuration, Experiment, choose

ABOUT = (
    "By preset and stage: *seconds* of the processor, all threads; *clock*, seconds of wall time; "
    "*megabytes*, peak memory while the stage ran. *start* is the interpreter and imports, *whole* "
    "everything."
)
_START, _WHOLE = "start", "whole"
_STAGES = (_START, *EXEMPLAR_STAGES, _WHOLE)

Cost = Mapping[str, float]
ByStage = Mapping[str, Cost]
Profiled = Callable[[str], ByStage | MatcapError]  # by preset; or why there is none


def profile_experiment(
    photographs: Sequence[Path], presets: Sequence[str]
) -> Experiment[Profiled, Cost]:
    """Every stage of every preset, on every photograph.

    Raises:
        UsageError: there is no such preset.
    """
    chosen = choose(PRESETS, presets)

    def prepare(path: Path) -> Profiled:
        return cache(partial(_tried, path))

    def cost(preset: str, stage: str, by_preset: Profiled, _seed: int) -> Cost:
        costs = by_preset(preset)
        if isinstance(costs, MatcapError):
            raise costs
        return costs[stage]

    return Experiment(
        "profile",
        {path.stem: partial(prepare, path) for path in photographs},
        {
            f"{preset}, {stage}": Configuration(partial(cost, preset, stage), preset)
            for preset in chosen
            for stage in _STAGES
        },
        settings=[path.resolve() for path in photographs],
    )


def _tried(photograph: Path, preset: str) -> ByStage | MatcapError:
    """A failure is remembered, too: its stages are not captured one by one."""
    try:
        return profiled(photograph, preset)
    except MatcapError as error:
        return error


def profiled(photograph: Path, preset: str) -> ByStage:
    """Cost of every stage of a capture, in a process of its own.

    Raises:
        MatcapError: the capture failed.
    """
    command = [sys.executable, "-m", __name__, str(photograph), preset]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        message = (done.stderr.strip().splitlines() or ["nothing was said"])[-1]
        raise MatcapError(f"the capture failed: {message}", where=str(photograph))
    costs: ByStage = json.loads(done.stdout)
    return costs


@dataclass
class StageCosts:
    """Processor seconds and peak memory of stages, from a capture's progress callback."""

    began: dict[str, float]
    """Processor seconds when a stage was entered."""
    ended: dict[str, float]
    megabytes: dict[str, float]

    def progress(self, now: CaptureProgress) -> None:
        """Progress callback: the first of a stage is its begin, the last its end."""
        if now.stage not in self.began:
            self.began[now.stage] = time.process_time()
            with suppress(OSError):  # forget the peak so far
                Path("/proc/self/clear_refs").write_text("5")
        self.ended[now.stage] = time.process_time()
        self.megabytes[now.stage] = _peak()

    def of(self, stage: str, clock: float) -> Cost:
        """Columns of a stage."""
        seconds = self.ended[stage] - self.began[stage]
        return {"seconds": seconds, "clock": clock, "megabytes": self.megabytes[stage]}


def _peak() -> float:
    """Peak memory since the stage began, MB; of the process where the kernel has no such reset."""
    with suppress(OSError, StopIteration):
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1e3
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)


def main(arguments: Sequence[str]) -> None:
    """Capture a photograph and print the cost of its stages as JSON."""
    photograph, preset = arguments
    keep_memory()  # as `matcap capture` does, before large libraries are imported
    from matcap.capture.run import capture_into

    costs, began = StageCosts({}, {}, {}), time.perf_counter()
    start, before = time.process_time(), _peak()
    with tempfile.TemporaryDirectory() as folder:
        result = capture_into(
            Path(folder) / "out",
            [photograph],
            CaptureSettings(preset=preset, generator="example"),
            OutputSettings(),
            costs.progress,
        )
    whole = {
        "seconds": time.process_time(),
        "clock": start + time.perf_counter() - began,
        "megabytes": max(before, *costs.megabytes.values()),
    }
    clocks = result.stage_seconds
    stages = {stage: costs.of(stage, clocks[stage]) for stage in costs.began}
    none = {"seconds": 0.0, "clock": 0.0, "megabytes": 0.0}
    first = {"seconds": start, "clock": start, "megabytes": before}
    left_out = {stage: none for stage in EXEMPLAR_STAGES if stage not in stages}
    print(json.dumps({_START: first, **left_out, **stages, _WHOLE: whole}))


if __name__ == "__main__":
    main(sys.argv[1:])
