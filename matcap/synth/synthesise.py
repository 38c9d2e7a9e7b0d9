"""Synthesise a rectangle of a material's field to files: `matcap synth`, for Python.

PyTorch is imported only where it is needed: a material with an exemplar does not need it, and
importing it takes longer than synthesising a map.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from matcap.synth.fields import open_field
from matcap.synth.request import SynthRequest, Work
from matcap.synth.stream import write_field


def synthesise(request: SynthRequest, folder: str | Path, work: Work | None = None) -> Path:
    """Write a request's map set into a folder, all files or none; return the path of its JSON file.

    Args:
        folder: created if missing.
        work: workers, progress callback and overwriting.

    Raises:
        UsageError: a size or period out of range, no CUDA device.
        MatcapError: what open_field and write_field raise.

    Example:
        synthesise(SynthRequest(material, Rectangle(0, 0, 4096, 256), seed=7), "more")
    """
    work = work or Work()
    if work.scheduler and request.device == "auto":
        # A cluster's machines may have no CUDA device, and all blocks must come from one kind.
        request = replace(request, device="cpu")
    request, opened = open_field(request)
    return write_field(request, opened, folder, work)
