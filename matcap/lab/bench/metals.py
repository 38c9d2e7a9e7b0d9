"""What is told of metals' F0: by channel, its hue, and beside what is no metal, for what is true.

Truth is at hand texel by texel (simulate/photograph.py, true_maps), so metal and what is none are
told apart by the truth, and how bright either is found counts too: nothing is scaled.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.piece.find import piece_maps
from matcap.capture.pipeline import capture_photo, read_photograph
from matcap.capture.settings import CaptureSettings
from matcap.lab.simulate.photograph import PhoneCamera, true_maps
from matcap.lab.simulate.specimen import Specimen, photograph

# Mean F0 above which a texel is metal and below which it is none; borders are left out.
METAL, NONE = 0.2, 0.08
_LEAST_SHARE = 0.01

Channels = tuple[float, float, float]


@dataclass(frozen=True)
class MetalRow:
    """What one photograph told.

    Attributes:
        material: its name.
        found, true: mean F0 by channel of what truly is metal.
        rest, true_rest: mean F0 of what is none; None where all is metal.
        channels: of the F0 that was found.
    """

    material: str
    found: Channels
    true: Channels
    rest: float | None
    true_rest: float | None
    channels: int

    @property
    def brightness(self) -> Channels:
        """Found over true, by channel."""
        r, g, b = (one / other for one, other in zip(self.found, self.true, strict=True))
        return r, g, b

    @property
    def hue(self) -> Channels:
        """The same of channels over their mean, less 1."""
        mean = sum(self.found) / sum(self.true)
        r, g, b = (one / mean - 1.0 for one in self.brightness)
        return r, g, b


def metal_row(name: str, found: MapSet, truth: MapSet) -> MetalRow:
    """Of found maps and true ones of the same rectangle.

    Args:
        name: of the material.
        found: of the photographed piece.
        truth: on any grid.
    """
    size = found.specular.shape[-2:]
    true = F.interpolate(truth.specular[None].float(), size, mode="area")[0].expand(3, -1, -1)
    told = found.specular.float().expand(3, -1, -1)
    grey = true.mean(0)
    metal, rest = grey > METAL, grey < NONE
    beside = float(rest.float().mean()) > _LEAST_SHARE
    return MetalRow(
        name,
        _mean(told, metal),
        _mean(true, metal),
        float(told[:, rest].mean()) if beside else None,
        float(true[:, rest].mean()) if beside else None,
        len(found.specular),
    )


def run_metals(
    chosen: Sequence[Specimen],
    out: Path,
    settings: CaptureSettings,
    *,
    camera: PhoneCamera | None = None,
    known: bool = False,
    tell: Callable[[str], None] = lambda _line: None,
) -> list[MetalRow]:
    """Photograph and capture each, and see what is told of F0.

    Args:
        chosen: materials.
        out: folder for the photographs.
        settings: of the captures.
        camera: that takes the photographs.
        known: the flash's strength is told, as a calibration card tells it; else F0 is as bright as
            materials most probably are (capture/piece/absolute.py).
        tell: called with a line of the table for each.
    """
    camera = camera or PhoneCamera()
    rows = []
    for subject in chosen:
        path, shot = photograph(subject, camera, out)
        photo = read_photograph(path, settings)
        if known:
            photo = replace(photo, flash_intensity=shot.setup.intensity[1])
        result = capture_photo(photo, settings)
        assert result.found is not None
        truth = true_maps(subject.pieces(subject.seed), camera, subject.setup)
        rows.append(metal_row(subject.name, piece_maps(result.found.exemplar), truth))
        tell(_line(rows[-1]))
    return rows


def metals_markdown(rows: Sequence[MetalRow], command: str) -> str:
    """A line a material: F0 found over true by channel, its hue, and F0 beside metal."""
    head = "| material | F0 found over true | hue off by, % | F0 beside it, found / true |"
    return "\n".join([f"    {command}", "", head, "|---|---|---|---|", *map(_line, rows)])


def _line(row: MetalRow) -> str:
    bright = ", ".join(f"{one:.2f}" for one in row.brightness)
    hue = ", ".join(f"{100.0 * one:+.0f}" for one in row.hue)
    hue = hue if row.channels > 1 else "grey"
    beside = "" if row.rest is None else f"{row.rest:.3f} / {row.true_rest:.3f}"
    return f"| {row.material} | {bright} | {hue} | {beside} |"


def _mean(planes: Tensor, where: Tensor) -> Channels:
    """Of each channel; where it is nowhere, of all."""
    chosen = planes[:, where] if bool(where.any()) else planes.flatten(1)
    r, g, b = chosen.mean(1).tolist()
    return r, g, b
