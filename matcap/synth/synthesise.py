"""More of a material, as files: what `matcap synth` does, for Python too.

Without PyTorch until it is needed: a material's file with an exemplar needs none, and it takes
longer to start than such a map takes to make.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from matcap.synth.fields import open_field
from matcap.synth.request import SynthRequest, Work
from matcap.synth.stream import write_field

if TYPE_CHECKING:
    from matcap.synth.precision import ChosenPrecision


def synthesise(
    asked: SynthRequest,
    folder: str | Path,
    work: Work | None = None,
    on_precision: Callable[[ChosenPrecision], None] = lambda choice: None,
) -> Path:
    """Write it into a folder, all of its files or none; returns the JSON file.

    Args:
        asked: what.
        folder: where to; made when missing.
        work: workers, and the progress callback.
        on_precision: called with a network's precision, once it is chosen.

    Raises:
        UsageError: a size or repeat out of range, a device that is not there.
        MatcapError: a mask that cannot be read, precisions too rough, and what write_field raises.

    Example:
        synthesise(SynthRequest(material, Rectangle(0, 0, 4096, 256), seed=7), "more")
    """
    work = work or Work()
    if work.scheduler and asked.device == "auto":
        # A cluster's machines may have no CUDA device, and their blocks must be alike.
        asked = replace(asked, device="cpu")
    asked, opened = open_field(asked)
    if opened.choice is not None:
        on_precision(opened.choice)
    return write_field(asked, opened, folder, work)
