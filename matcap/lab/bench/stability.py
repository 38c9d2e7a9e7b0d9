"""`matcap bench stability`: does anything ever come out NaN or infinite, and how right is float32?

Two sweeps, one table. The reflectance: random draws from every corner of its domain, values and
gradients (stability_reflectance.py). Photographs: pictures that go wrong in every way we know of
(stability_photographs.py), captured for a few steps; each must end in finite maps or in one
sentence that says why not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import torch
from numpy.typing import NDArray

from matcap.capture.pipeline import CaptureResult, capture_photo
from matcap.capture.settings import CaptureSettings
from matcap.errors import MatcapError
from matcap.lab.bench.stability_photographs import FOV, HARD_PHOTOGRAPHS
from matcap.lab.bench.stability_reflectance import (
    CASES,
    SMOOTH,
    CaseResult,
    measure,
    measure_shading,
)
from matcap.photo.load import photo_from_array

_MAPS = ("diffuse", "specular", "roughness", "height", "normal")
_ASPECT = 0.75


@dataclass(frozen=True)
class StabilitySettings:
    """How large the sweep is.

    Attributes:
        draws: of the reflectance, of each case.
        photographs: how many in all; the cases take turns, each time with another seed and prior.
        detail: texels across each photograph.
        steps: of fine-tuning.
        seed: of everything.
    """

    draws: int = 100_000
    photographs: int = 500
    detail: int = 128
    steps: int = 3
    seed: int = 0


QUICK = StabilitySettings(draws=5_000, photographs=len(HARD_PHOTOGRAPHS), detail=96, steps=2)


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        case: what was drawn.
        draws: how many.
        values: of them with a value that is NaN or infinite, or that ended in a bug.
        gradients: gradients that were not finite; of photographs, steps that were taken back.
        worst: the largest error, in words.
        where: it was.
    """

    case: str
    draws: int
    values: int
    gradients: int
    worst: str
    where: str


def run_stability(
    settings: StabilitySettings, tell: Callable[[str], None] = lambda _line: None
) -> list[Row]:
    """The whole sweep; `tell` hears of every row."""
    rows = []
    for name, case in CASES.items():
        rows.append(_reflectance_row(name, measure(case, settings.draws, settings.seed)))
        tell(_line(rows[-1]))
    rendered = measure_shading(settings.draws, settings.seed)
    rows.append(_reflectance_row("rendering, light 1e-3 to 1e9 away", rendered))
    tell(_line(rows[-1]))
    for name, count in _shares(settings.photographs).items():
        rows.append(_photograph_row(name, count, settings))
        tell(_line(rows[-1]))
    return rows


def unstable(rows: Sequence[Row]) -> int:
    """How many values or gradients were not finite."""
    of_reflectance = islice(rows, len(CASES) + 1)
    return sum(row.values for row in rows) + sum(row.gradients for row in of_reflectance)


def markdown(rows: Sequence[Row], command: str) -> str:
    """The table as a section of documentation."""
    lines = [
        "Measured by:",
        "",
        f"    {command}",
        "",
        "| case | draws | non-finite values | non-finite gradients | worst error | where |",
        "|---|---:|---:|---:|---|---|",
    ]
    lines += [
        f"| {row.case} | {row.draws} | {row.values} | {row.gradients} | {row.worst} | {row.where} |"
        for row in rows
    ]
    return "\n".join(lines) + "\n"


def capture_array(
    pixels: NDArray[np.float32], settings: CaptureSettings, name: str
) -> CaptureResult:
    """Capture a picture given as an array, as a RAW would be.

    Raises:
        MatcapError: it is refused.
    """
    photo = photo_from_array(
        pixels, long_side=settings.detail, fov=FOV, radiometric=True, name=name
    )
    return capture_photo(photo, settings)


def finite(result: CaptureResult) -> bool:
    """Whether maps, re-rendering, statistics and weights are free of NaN and infinity."""
    material = result.material
    tensors = [getattr(result.maps, name) for name in _MAPS]
    tensors += [moment for pair in material.moments for moment in pair]
    tensors += list(material.decoder.state_dict().values())
    numbers = (*material.setup.offset, *material.setup.tilt, *material.setup.intensity)
    return (
        all(bool(torch.isfinite(tensor).all()) for tensor in tensors)
        and bool(np.isfinite(result.rerendered).all())
        and all(math.isfinite(number) for number in numbers)
    )


def _reflectance_row(name: str, found: CaseResult) -> Row:
    errors = [
        f"{error:.1e} {which} roughness {SMOOTH}"
        for error, which in ((found.worst, "from"), (found.worst_smooth, "below"))
        if error > 0.0
    ]
    return Row(
        name, found.draws, found.values, found.gradients, ", ".join(errors) or "0", found.where
    )


def _shares(photographs: int) -> dict[str, int]:
    """How often each case is captured."""
    cases = len(HARD_PHOTOGRAPHS)
    counts = {
        name: photographs // cases + (index < photographs % cases)
        for index, name in enumerate(HARD_PHOTOGRAPHS)
    }
    return {name: count for name, count in counts.items() if count}


def _photograph_row(name: str, count: int, settings: StabilitySettings) -> Row:
    row = Row(f"photograph: {name}", 0, 0, 0, "", "")
    worst = 0.0
    for index in range(count):
        row = replace(row, draws=row.draws + 1)
        asked = CaptureSettings(
            steps=settings.steps,
            detail=settings.detail,
            seed=settings.seed + index,
            prior="none" if index % 2 else "auto",
        )
        try:
            pixels = HARD_PHOTOGRAPHS[name](
                settings.detail, round(_ASPECT * settings.detail), asked.seed
            )
            result = capture_array(pixels, asked, name)
        except MatcapError as error:
            row = replace(row, where=f"refused: {error.what}")
            continue
        except Exception as error:  # a bug is what this looks for, and the sweep goes on
            what = f"{type(error).__name__}: {error}".splitlines()[0]
            row = replace(row, values=row.values + 1, where=what)
            continue
        taken_back = settings.steps - len(result.history)
        row = replace(row, gradients=row.gradients + taken_back)
        if not finite(result):
            row = replace(row, values=row.values + 1, where=f"seed {asked.seed}, {asked.prior}")
        worst = max([worst, *(error for _, _, error in result.history[-1:])])
    return replace(row, worst=f"style error {worst:.2g}" if worst else "")


def _line(row: Row) -> str:
    return f"{row.case:34} {row.draws:7} {row.values:3} {row.gradients:3}  {row.worst}  {row.where}"
