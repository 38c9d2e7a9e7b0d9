"""What the pages that tell how a prior was measured share: tables and a sheet of pictures."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch

from matcap.files.staging import staged_file
from matcap.lab.train.measure import Result

_QUALITY = 85  # of sheets; they are looked at, not measured

# Ends of pages: what the columns count in.
COLUMNS = """\
Style: error of the statistics of random filters that no capture optimises, 0 for the same, 2 for
as unlike as can be. XYZ: share of the picture whose colour the photograph does
not have. Diversity: mean distance between the features of realisations, place by
place, 0 for the same picture, at most 2. All three under the photograph's own
flash, in its middle; medians over the materials."""


def median(results: Sequence[Result], method: str, of: Callable[[Result], float]) -> float:
    """Of one number over the materials."""
    return statistics.median(of(result) for result in results if result.method == method)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table: the first column to the left, numbers to the right."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return ["| " + " | ".join(line) + " |" for line in lines]


def names(results: Sequence[Result], of: Callable[[Result], str]) -> list[str]:
    """Methods or materials, in the order of the first result."""
    return list(dict.fromkeys(of(result) for result in results))


def write_sheet(results: Sequence[Result], path: Path) -> None:
    """JPEG, half the size: a column a material, a row a method.

    Raises:
        MatcapError: the file cannot be written.
    """
    columns = [
        torch.cat([r.picture for r in results if r.material == material], dim=1)
        for material in names(results, lambda r: r.material)
    ]
    code = torch.cat(columns, dim=2)[:, ::2, ::2].permute(1, 2, 0)
    stored = np.ascontiguousarray((code * 255.0).round().byte().numpy()[..., ::-1])
    _, encoded = cv2.imencode(".jpg", stored, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    with staged_file(path) as file:
        file.write_bytes(encoded.tobytes())
