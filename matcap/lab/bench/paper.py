"""Capture as in the paper, a baseline: an hour and more of a core.

    python -m matcap.lab.bench.paper PHOTO MATERIAL SEED

The paper's decoder from random weights, 1000 steps, on the largest square window of its 512 x 384
texels; a filter bank replaces VGG-19.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from matcap.capture.method import Method
from matcap.capture.pipeline import capture_photo, read_photograph
from matcap.capture.settings import CaptureSettings
from matcap.space.decoder import PAPER_CONFIG
from matcap.statistics.filterbank import FilterBankConfig

STEPS = 1000
_METHOD = Method(
    window=384,
    features=FilterBankConfig(sizes=(3, 5, 9), filters=48, crossed=False),
    decoder=PAPER_CONFIG,
    half_precision=False,
    places=1,
    matched=False,
)


def capture_as_in_paper(
    photo: Path, material: Path, seed: int, steps: int = STEPS, detail: int = 512
) -> None:
    """Capture a photograph and write the material's file."""
    settings = CaptureSettings(
        steps=steps, detail=detail, seed=seed, prior="none", generator="decoder", drawing=False
    )
    read = read_photograph(photo, settings)
    capture_photo(read, settings, method=_METHOD).material.save(material)


def main(arguments: Sequence[str]) -> None:
    """Capture a photograph."""
    photo, material, seed = arguments
    capture_as_in_paper(Path(photo), Path(material), int(seed))


if __name__ == "__main__":
    main(sys.argv[1:])
