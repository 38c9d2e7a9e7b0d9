"""What materials drawn from a prior are worth beside photographs of materials it never saw.

Draws lie in the middle of a photograph's plane under a flash; of every photograph, held out or
simulated of a seed that training never draws, the middle is taken. All are brought to the same
mean radiance, and compared as bench/variety.py says.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from matcap.capture.prior.store import Prior
from matcap.files.srgb import srgb_encode_tensor
from matcap.files.staging import staged_file
from matcap.flash.geometry import plane_points
from matcap.flash.render import render_flash
from matcap.lab.bench.variety import Variety, describe_pictures, variety
from matcap.lab.train.corpus import LONG_SIDE, simulated_code
from matcap.lab.train.evaluate import UNSEEN
from matcap.lab.train.pack import Entry, Pack, linear_of
from matcap.lab.train.pages import table
from matcap.model.material import Material

_SIZE = 256  # texels a side of what is compared
_MEAN = 0.25  # radiance that every picture is brought to
_SHEET, _COLUMNS = 64, 8  # draws that are shown, and how many side by side
_SHOWN = 192  # texels a side of each
_QUALITY = 85


@dataclass(frozen=True)
class VarietySettings:
    """What is compared.

    Attributes:
        draws: how many materials are drawn, of seeds 0, 1, ...
        simulated: how many unseen simulated photographs stand beside the held-out ones.
    """

    draws: int = 256
    simulated: int = 64


def run_variety(
    prior: Prior,
    pack: Pack,
    settings: VarietySettings,
    out: Path,
    command: str,
    tell: Callable[[str], None] = lambda line: None,
) -> str:
    """Measure draws, write prior-variety.md and .jpg into a folder, and return the page."""
    real = [middle(entry) for entry in pack.reporting]
    seeds = range(UNSEEN, UNSEEN + settings.simulated)
    simulated = [_exposed(_cut(linear_of(simulated_code(seed)[0]))) for seed in seeds]
    tell(f"{len(real)} held-out photographs and {len(simulated)} simulated ones")
    known = [middle(entry) for entry in pack.training]
    drawn = []
    for seed in range(settings.draws):
        drawn.append(lit(prior.draw(seed)))
        if (seed + 1) % 16 == 0:
            tell(f"{seed + 1} of {settings.draws} draws")
    made, ceiling = describe_pictures(drawn), describe_pictures(known)
    rows = []
    for name, true in (
        ("all", [*real, *simulated]),
        ("photographs", real),
        ("simulated", simulated),
    ):
        there = describe_pictures(true)
        rows.append((f"draws, {name}", variety(made, there)))
        rows.append((f"training photographs, {name}", variety(ceiling, there)))
    everything = rows[0][1]
    page = markdown(rows, settings, len(real), command)
    out.mkdir(parents=True, exist_ok=True)
    (out / "prior-variety.md").write_text(page)
    order = everything.nearest[:_SHEET].argsort(stable=True).tolist()
    write_grid([drawn[index] for index in order], out / "prior-variety.jpg")
    return page


def middle(entry: Entry) -> Tensor:
    """(3, _SIZE, _SIZE) sRGB, the middle of a photograph of the pack."""
    return _exposed(_cut(torch.from_numpy(entry.photo().pixels.transpose(2, 0, 1).copy())))


def lit(material: Material) -> Tensor:
    """(3, _SIZE, _SIZE) sRGB of a material lying in the middle of a photograph, under its flash."""
    maps = material.maps(_SIZE, _SIZE)
    width, height = LONG_SIDE, LONG_SIDE * 3 // 4
    x, y = (width - _SIZE) // 2, (height - _SIZE) // 2
    points = plane_points(x, y, _SIZE, _SIZE, (width, height), dtype=torch.float32)
    with torch.inference_mode():
        return _exposed(render_flash(maps, material.setup, points))


def markdown(
    rows: Sequence[tuple[str, Variety]], settings: VarietySettings, real: int, command: str
) -> str:
    """The page."""
    lines = [
        "# How varied the space is",
        "",
        f"Made by `{command}`: {settings.draws} materials drawn from the prior, beside {real} "
        "held-out",
        f"photographs and {settings.simulated} simulated ones of seeds that training never draws.",
        "",
        *table(
            ["of, beside", "precision", "recall", "pairwise distance", "of theirs"],
            [
                [
                    name,
                    f"{found.precision:.2f}",
                    f"{found.recall:.2f}",
                    f"{found.apart:.3f}",
                    f"{found.spread:.2f}",
                ]
                for name, found in rows
            ],
        ),
        "",
        "Precision and recall after Kynkaanniemi et al. (2019), third neighbours, by statistics of",
        "random filters that nothing is trained on (bench/variety.py); all pictures are brought to",
        "the same mean radiance. Pairwise distance: mean style distance of two of them, and its",
        "share of that of two photographs. The rows of training photographs say what a space that",
        "shows nothing but what it was trained on would reach.",
        "",
        f"![{_SHEET} draws, in the order of the photographs they are nearest to]"
        "(prior-variety.jpg)",
        "",
    ]
    return "\n".join(lines)


def write_grid(pictures: Sequence[Tensor], path: Path) -> None:
    """JPEG of sRGB pictures, a row after another.

    Raises:
        MatcapError: the file cannot be written.
    """
    blank = torch.zeros_like(pictures[0])
    padded = [*pictures, *[blank] * (-len(pictures) % _COLUMNS)]
    rows = [torch.cat(padded[i : i + _COLUMNS], dim=2) for i in range(0, len(padded), _COLUMNS)]
    code = torch.cat(rows, dim=1).permute(1, 2, 0).numpy()[..., ::-1]
    share = _SHOWN / pictures[0].shape[-1]
    small = cv2.resize(code, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    stored = np.ascontiguousarray((small * 255.0).round().astype(np.uint8))
    _, encoded = cv2.imencode(".jpg", stored, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    with staged_file(path) as file:
        file.write_bytes(encoded.tobytes())


def _cut(linear: Tensor) -> Tensor:
    """The middle of (3, H, W)."""
    y, x = ((side - _SIZE) // 2 for side in linear.shape[-2:])
    return linear[:, y : y + _SIZE, x : x + _SIZE]


def _exposed(linear: Tensor) -> Tensor:
    """SRGB of radiance, brought to the mean that all have."""
    gain = _MEAN / linear.mean().clamp_min(1e-6)
    return srgb_encode_tensor((linear * gain).clamp(0.0, 1.0))
