"""`sweep.py`: does anything ever come out NaN or infinite, and how right is float32?

Two sweeps, one table; relighting and exporting have another (edges/table.py). The reflectance:
random draws from every corner of its domain, values and gradients (reflectance.py).
Photographs: pictures that go wrong in every way we know of (photographs.py), captured
for a few steps, their piece's own maps found and rearranged, as they are and with every variety;
sets of photographs and parts of them likewise (wholes.py). Each must end in finite maps within
their ranges or in one sentence that says why not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import torch
from numpy.typing import NDArray

from matcap.capture.method import Method
from matcap.capture.piece.find import ExemplarEstimate
from matcap.capture.pipeline import capture_photo
from matcap.capture.result import CaptureResult
from matcap.capture.settings import CaptureSettings
from matcap.errors import MatcapError
from matcap.field.plane import Rectangle
from matcap.photo.load import photo_from_array
from matcap.space.tuned import TunedDecoder
from stable.photographs import FOV, HARD_PHOTOGRAPHS
from stable.reflectance import (
    CASES,
    SMOOTH,
    CaseResult,
    measure,
    measure_shading,
)
from stable.wholes import HARD_SETS, PARTS, capture_part, capture_set

_MAPS = ("diffuse", "specular", "roughness", "height", "normal")
_ASPECT = 0.75
_PRESET = "draft"  # adapts the piece in a few steps
_FIELD = 64  # texels a side of what is read by example
_VARIETIES = (None, 0.0, 1.0)  # its own, and the ends
_LARGE, _LARGE_EVERY = 3, 4


@dataclass(frozen=True)
class StabilitySettings:
    """How large the sweep is.

    Attributes:
        draws: of the reflectance, of each case.
        photographs: how many in all; the cases take turns, each time with another seed and prior.
        sets: of photographs, and parts of them, likewise.
        detail: texels across each photograph; every fourth of a case has three times as many, for
            a small one has too few windows to tell relief's strength.
        steps: of fine-tuning.
        relighting: draws of relighting and exporting, over all their domains.
        seed: of everything.
    """

    draws: int = 100_000
    photographs: int = 500
    sets: int = 300
    detail: int = 128
    steps: int = 3
    relighting: int = 10_000_000
    seed: int = 0


QUICK = StabilitySettings(
    draws=5_000,
    photographs=len(HARD_PHOTOGRAPHS),
    sets=len(HARD_SETS) + len(PARTS),
    detail=96,
    steps=2,
    relighting=200_000,
)


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        case: what was drawn.
        draws: how many.
        values: of them with a value that is NaN or infinite, of maps also out of range, or that
            ended in a bug.
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
    for name, count in _shares(HARD_PHOTOGRAPHS, settings.photographs).items():
        rows.append(_photograph_row(name, count, settings))
        tell(_line(rows[-1]))
    for name, count in _shares(WHOLES, settings.sets).items():
        rows.append(_whole_row(name, count, settings))
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
        "| case | draws | non-finite values | gradients, or steps back | worst error | where |",
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
    """Capture a picture given as an array, as a RAW would be, and match it to the photograph.

    Raises:
        MatcapError: it is refused.
    """
    photo = photo_from_array(
        pixels, long_side=settings.detail, fov=FOV, radiometric=True, name=name
    )
    return capture_photo(photo, settings, method=Method(matched=True))


def finite(result: CaptureResult) -> bool:
    """Whether maps, re-rendering, statistics and weights are free of NaN and infinity.

    Of the photographed piece too, where it was found.
    """
    material = result.material
    tensors = [getattr(result.maps, name) for name in _MAPS]
    tuned = material.part(TunedDecoder)
    if tuned is not None:
        tensors += [moment for pair in tuned.moments for moment in pair]
        tensors += list(tuned.decoder.state_dict().values())
    numbers = [*material.setup.offset, *material.setup.tilt, *material.setup.intensity]
    if result.estimate is not None:
        tensors += _piece(result.estimate, result.settings.seed)
        numbers += [result.estimate.error, result.estimate.slow]
    return (
        all(bool(torch.isfinite(tensor).all()) for tensor in tensors)
        and bool(np.isfinite(result.rerendered).all())
        and all(math.isfinite(number) for number in numbers)
    )


def within_ranges(found: ExemplarEstimate, seed: int) -> bool:
    """Whether albedo, F0 and roughness of the piece and of a field made of it are in [0, 1]."""
    return all(
        bool((maps[:5] >= 0.0).all() and (maps[:5] <= 1.0).all())
        for maps in _piece(found, seed)[: 1 + len(_VARIETIES)]
    )


def _piece(found: ExemplarEstimate, seed: int) -> list[torch.Tensor]:
    """The piece's maps, small fields that rearrange them, and what the photograph told."""
    area = Rectangle(0, 0, _FIELD, _FIELD)
    fields = [found.example.varied(variety).maps(seed, area, None) for variety in _VARIETIES]
    told = found.strengths
    numbers = [] if told is None else [told.albedo, told.slope, told.trust]
    return [torch.from_numpy(array) for array in (found.exemplar.stacked(), *fields, *numbers)]


def _reflectance_row(name: str, found: CaseResult) -> Row:
    errors = [
        f"{error:.1e} {which} roughness {SMOOTH}"
        for error, which in ((found.worst, "from"), (found.worst_smooth, "below"))
        if error > 0.0
    ]
    return Row(
        name, found.draws, found.values, found.gradients, ", ".join(errors) or "0", found.where
    )


def _shares(cases: Mapping[str, object], total: int) -> dict[str, int]:
    """How often each case is captured."""
    counts = {
        name: total // len(cases) + (index < total % len(cases)) for index, name in enumerate(cases)
    }
    return {name: count for name, count in counts.items() if count}


def _photograph_row(name: str, count: int, settings: StabilitySettings) -> Row:
    row = Row(f"photograph: {name}", 0, 0, 0, "", "")
    worst = of_piece = 0.0
    for index in range(count):
        row = replace(row, draws=row.draws + 1)
        large = index % _LARGE_EVERY == _LARGE_EVERY - 1
        detail = settings.detail * (_LARGE if large else 1)
        asked = CaptureSettings(
            preset=_PRESET,
            steps=settings.steps,
            detail=detail,
            seed=settings.seed + index,
            prior="none" if index % 2 else "auto",
            generator="decoder",
            aligned=True,
        )

        def captured(detail: int = detail, asked: CaptureSettings = asked) -> CaptureResult:
            pixels = HARD_PHOTOGRAPHS[name](detail, round(_ASPECT * detail), asked.seed)
            return capture_array(pixels, asked, name)

        row, result = _attempted(row, captured)
        if result is None:
            continue
        history = result.tuning.history if result.tuning else ()
        taken_back = settings.steps - len(history)
        row = replace(row, gradients=row.gradients + taken_back)
        assert result.estimate is not None
        if not (finite(result) and within_ranges(result.estimate, asked.seed)):
            row = replace(row, values=row.values + 1, where=f"seed {asked.seed}, {asked.prior}")
        worst = max([worst, *(error for _, _, error in history[-1:])])
        of_piece = max(of_piece, result.estimate.error)
    return replace(row, worst=f"style {worst:.2g}, piece {of_piece:.2g}" if worst else "")


def _attempted(row: Row, capture: Callable[[], CaptureResult]) -> tuple[Row, CaptureResult | None]:
    """A capture, or the row with what became of it: refused is well, a bug is not."""
    try:
        return row, capture()
    except MatcapError as error:
        return replace(row, where=f"refused: {error.what}"), None
    except Exception as error:  # a bug is what this looks for, and the sweep goes on
        what = f"{type(error).__name__}: {error}".splitlines()[0]
        return replace(row, values=row.values + 1, where=what), None


_Whole = Callable[[int, int, CaptureSettings, str], CaptureResult]


def of_set(name: str) -> _Whole:
    """A set of HARD_SETS, captured."""
    return lambda width, height, asked, told: capture_set(
        HARD_SETS[name](width, height, asked.seed), asked, told
    )


def of_part(name: str) -> _Whole:
    """A part of PARTS, captured."""
    photograph = HARD_PHOTOGRAPHS["an ordinary one"]
    return lambda width, height, asked, told: capture_part(
        photograph(width, height, asked.seed), PARTS[name], asked, told
    )


WHOLES: Mapping[str, _Whole] = {
    **{f"set: {name}": of_set(name) for name in HARD_SETS},
    **{f"part: {name}": of_part(name) for name in PARTS},
}


def _whole_row(name: str, count: int, settings: StabilitySettings) -> Row:
    """A set or a part, so many times; large enough for keypoints and for relief's strength."""
    row = Row(name, 0, 0, 0, "", "")
    worst, detail = 0.0, _LARGE * settings.detail
    for index in range(count):
        seed = settings.seed + index
        asked = CaptureSettings(preset=_PRESET, steps=settings.steps, detail=detail, seed=seed)

        def captured(asked: CaptureSettings = asked) -> CaptureResult:
            return WHOLES[name](detail, round(_ASPECT * detail), asked, name)

        row, result = _attempted(replace(row, draws=row.draws + 1), captured)
        if result is None:
            continue
        assert result.estimate is not None
        if not (finite(result) and within_ranges(result.estimate, seed)):
            row = replace(row, values=row.values + 1, where=f"seed {seed}")
        worst = max(worst, result.estimate.error)
    return replace(row, worst=f"piece {worst:.2g}" if worst else "")


def _line(row: Row) -> str:
    return f"{row.case:34} {row.draws:7} {row.values:3} {row.gradients:3}  {row.worst}  {row.where}"
