"""`matcap bench fields`: fields and repeated pieces of true maps, so that nothing else is judged.

True maps of a piece of a known material are the exemplar. Its field and the piece made to repeat
are relit and compared with other true pieces, in floors (distance.py), as the piece itself is.
Beside them: how long joints are for the truth's, and how far the lattice's phase is off far away.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from matcap.brdf.maps import CHANNELS, MapSet
from matcap.errors import MatcapError
from matcap.example.example import Example, detail_bits
from matcap.example.exemplar import Exemplar
from matcap.example.variety import chosen
from matcap.field.plane import Rectangle
from matcap.lab.floors.distance import Measure
from matcap.lab.floors.run import FloorSettings, Judge, middle_of, side_of
from matcap.lab.simulate.examples import EXAMPLES
from matcap.lab.simulate.materials.kinds import kinds_known
from matcap.lab.simulate.specimen import Specimen
from matcap.statistics.lattice import find_lattice

_SIZE = (1024, 768)  # texels of the exemplar
_SEEDS = (0, 1)
_ELSEWHERE = (300, 100)  # texels: nothing special about the origin
_FAR = 16384  # texels
_SHORTEST = 8  # texels: of a joint
_JOINT = 9  # texels: wider valleys are none


@dataclass(frozen=True)
class FieldRow:
    """One material.

    Attributes:
        material: which.
        variety: that was chosen.
        piece, field, repeated: floors; 1 is indistinguishable.
        joints: median length of a joint in the field over that of the exemplar, or None where
            there are too few.
        phase: turns that a lattice is off by, 16384 texels away, of its worst wave; None without.
    """

    material: str
    variety: float
    piece: float
    field: float
    repeated: float
    joints: float | None
    phase: float | None


def true_example(maps: MapSet) -> Example:
    """An exemplar of true maps, as a capture indexes one."""
    found = {name: np.ascontiguousarray(getattr(maps, name).float().numpy()) for name in CHANNELS}
    width, height = maps.size
    trusted = np.ones((len(CHANNELS), height, width), np.float32)
    exemplar = Exemplar(**found, confidence=trusted, texel_size=maps.texel_size)
    colour = torch.from_numpy(exemplar.diffuse).clamp(0.0, 1.0) ** (1.0 / 2.2)
    lattice = find_lattice(colour, torch.ones(height, width, dtype=torch.bool))
    return chosen(Example.of(exemplar, tuple((w.fx, w.fy) for w in lattice.waves)))


def run_fields(
    subjects: Sequence[Specimen],
    settings: FloorSettings | None = None,
    *,
    measure: Measure | None = None,
    tell: Callable[[str], None] = lambda _line: None,
) -> list[FieldRow]:
    """Judge all; what has no such maps is told and left out."""
    settings, measure = settings or FloorSettings(), measure or Measure()
    rows = []
    for subject in subjects:
        try:
            row = judge_field(subject, settings, measure)
        except MatcapError as error:
            tell(f"{subject.name}: {error}")
            continue
        tell(f"{row.material:28} piece {row.piece:5.2f}  field {row.field:5.2f}  "
             f"repeated {row.repeated:5.2f}")  # fmt: skip
        rows.append(row)
    return rows


def judge_field(subject: Specimen, settings: FloorSettings, measure: Measure) -> FieldRow:
    """What the field of a material's true maps comes to."""
    maps = subject.pieces(subject.seed)(*_SIZE, 2.0 / _SIZE[0])
    example = true_example(maps)
    judge = Judge(subject, subject.setup, settings, measure)
    light, texel = subject.setup.intensity, maps.texel_size
    side = side_of(texel, settings)
    fields = [
        torch.from_numpy(example.maps(seed, Rectangle(*_ELSEWHERE, side, side), None))
        for seed in _SEEDS
    ]
    repeated = example.repeating().stacked()
    # Where the copies meet lies in the middle of what is compared.
    around = repeated.roll((side // 2, side // 2), (1, 2)).repeat(1, 2, 2)[:, :side, :side]

    def floors(stacked: torch.Tensor) -> float:
        return judge.floors(MapSet.from_stacked(stacked, texel), light)

    lengths = [joint_length(one) for one in (fields[0][-1].numpy(), example.exemplar.height[0])]
    return FieldRow(
        subject.name,
        example.variety,
        floors(middle_of(example.piece(), side).stacked()),
        sum(floors(one) for one in fields) / len(fields),
        floors(around),
        None if None in lengths else float(lengths[0] or 0.0) / float(lengths[1] or 1.0),
        phase_off(example),
    )


def joint_length(height: NDArray[np.float32]) -> float | None:
    """Median length in texels of the lines that narrow valleys are, from crossing to crossing.

    None where there are less than twenty.
    """
    smooth = cv2.GaussianBlur(height.astype(np.float32), (0, 0), 1.0)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_JOINT, _JOINT))
    deep = cv2.morphologyEx(smooth, cv2.MORPH_BLACKHAT, kernel)
    top = float(np.quantile(deep, 0.999))
    if top <= 0.0:
        return None
    eight = (deep / top * 255.0).clip(0.0, 255.0).astype(np.uint8)
    _, valleys = cv2.threshold(eight, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    lines = (cv2.ximgproc.thinning(valleys) > 0).astype(np.uint8)
    around = cv2.filter2D(lines, -1, np.ones((3, 3), np.uint8)) - lines
    ends = lines * (around < 3)
    _, _, stats, _ = cv2.connectedComponentsWithStats(ends, connectivity=8)
    sizes = stats[1:, cv2.CC_STAT_AREA]
    long = sizes[sizes >= _SHORTEST]
    return float(np.median(long)) if len(long) >= 20 else None


def phase_off(example: Example) -> float | None:
    """Turns that the field's lattice is off by at 16384 texels both ways; None without one."""
    order = example.index.order
    if order is None:
        return None
    bits = detail_bits(example.exemplar)
    worst = 0.0
    for x, y in ((_FAR, 0), (0, _FAR), (-_FAR, _FAR)):
        places = example.places(0, Rectangle(x, y, 256, 256), None).astype(np.int64) >> bits
        columns, rows = (np.arange(at, at + 256) >> bits for at in (x, y))
        wanted = order.wanted(0, columns[None, :], rows[:, None], (None, None))
        apart = (order.phases(places[..., 0], places[..., 1]) - wanted).astype(np.int16)
        turns = np.exp(2j * np.pi * apart.astype(np.float64) / 2**16).mean(axis=(0, 1))
        worst = max(worst, float(np.abs(np.angle(turns)).max()) / (2.0 * np.pi))
    return worst


def grating(period: float, angle: float, size: tuple[int, int] = _SIZE) -> Example:
    """A weave of one period at an angle in degrees, of true maps."""
    y, x = np.mgrid[: size[1], : size[0]].astype(np.float64)
    turn = np.deg2rad(angle)
    waves = [(np.cos(turn) / period, np.sin(turn) / period)]
    waves += [(-np.sin(turn) / period, np.cos(turn) / period)]
    threads = sum(np.cos(2.0 * np.pi * (fx * x + fy * y)) for fx, fy in waves)
    noise = np.random.default_rng(0).standard_normal(x.shape)
    plane = (0.4 + 0.1 * threads + 0.02 * noise).clip(0.0, 1.0).astype(np.float32)[None]
    exemplar = Exemplar(
        plane.repeat(3, axis=0), 0.1 * plane, plane, 0.01 * plane,
        np.ones((len(CHANNELS), *x.shape), np.float32), 2.0 / size[0],
    )  # fmt: skip
    return replace(Example.of(exemplar, tuple(waves)), variety=1.0)


def fields_markdown(rows: Sequence[FieldRow], command: str) -> str:
    """A table: a line a material, and the means and worst of examples, kinds and map sets."""

    def told(value: float | None, digits: int = 2) -> str:
        return "" if value is None else f"{value:.{digits}f}"

    lines = [
        f"Measured by `{command}`. Floors of true maps: 1 is what two true pieces differ by.",
        "",
        "| material | variety | piece | field | repeated | joints | phase, turns |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {row.material} | {row.variety:.2g} | {row.piece:.2f} | {row.field:.2f} "
        f"| {row.repeated:.2f} | {told(row.joints)} | {told(row.phase, 3)} |"
        for row in rows
    ]
    for group in dict.fromkeys(_group(row.material) for row in rows):
        members = [row for row in rows if _group(row.material) == group]
        judged = ("piece", "field", "repeated")
        of = [[getattr(row, name) for row in members] for name in judged]
        means = " | ".join(f"{sum(one) / len(one):.2f}" for one in of)
        worst = " | ".join(f"{max(one):.2f}" for one in of)
        lines += [f"| mean of {group} | | {means} | | |", f"| worst of {group} | | {worst} | | |"]
    return "\n".join(lines) + "\n"


def _group(material: str) -> str:
    if material in EXAMPLES:
        return "examples"
    return "kinds" if material.partition(":")[0] in kinds_known() else "map sets"
