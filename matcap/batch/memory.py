"""Memory that one worker needs, and the number of workers that fit.

Measured on Linux, glibc (docs/notes/stability.md has the command): the libraries,
the photograph as it is developed, what grows with the detail, and what grows with the map set.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from pathlib import Path

from matcap.batch.settings import BatchSettings
from matcap.capture.detail import UNION_TIMES
from matcap.files.memory import free_bytes

_LIBRARIES = 1_150_000_000  # and one window being tuned
_BY_PIXEL = {"raw": 22, "other": 12}  # bytes a pixel of the file
_BY_TEXEL = 400  # of the photograph as it is used, detail x 3/4 detail
_BY_MAP_TEXEL = 110  # bytes
_USUAL_PIXELS = 12_000_000  # where a file does not say
_SPARE = 0.85  # of what is free: the rest is for everybody else
_RAW_FORMS = ("RAW", "DNG")


def worker_bytes(settings: BatchSettings, pixels: int, *, raw: bool) -> int:
    """What one worker takes at most.

    Args:
        settings: detail and size of the map set count.
        pixels: of the largest photograph.
        raw: whether it has to be developed.
    """
    width, height = settings.outputs.size
    detail = settings.capture.most_detail
    return (
        _LIBRARIES
        + _BY_PIXEL["raw" if raw else "other"] * pixels
        + _BY_TEXEL * detail * detail * 3 // 4 * (UNION_TIMES if settings.capture.union else 1)
        + _BY_MAP_TEXEL * width * height
    )


def largest_worker(settings: BatchSettings, photos: Sequence[Path]) -> int:
    """worker_bytes of the photograph that takes most."""
    sizes = [photo_pixels(photo) for photo in photos] or [(_USUAL_PIXELS, False)]
    return max(worker_bytes(settings, pixels, raw=raw) for pixels, raw in sizes)


def photo_pixels(path: Path) -> tuple[int, bool]:
    """How many pixels a photograph has, by its header, and whether it is a RAW.

    What cannot be read is taken for usual: reading it will say why.
    """
    from matcap.files.quiet import quiet_decoders
    from matcap.photo.kind import file_kind
    from matcap.photo.refusals import MOST_PIXELS

    try:
        with quiet_decoders():
            raw = file_kind(path).value in _RAW_FORMS
            if raw:
                import rawpy

                with rawpy.imread(str(path)) as file:
                    return int(file.sizes.raw_width) * int(file.sizes.raw_height), True
            from PIL import Image

            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # of large pictures: they are counted here
                    with Image.open(path) as picture:
                        return picture.width * picture.height, False
            except Image.DecompressionBombError:  # what Pillow's own limit lets not be counted
                return MOST_PIXELS, False
    except Exception:
        return _USUAL_PIXELS, path.suffix.lower() not in (".jpg", ".jpeg", ".png")


def crew_size(wanted: int | None, each: int, jobs: int, free: int | None = None) -> int:
    """How many workers: as wanted or as cores, as many as fit, no more than there are jobs."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    fit = int(_SPARE * (free_bytes() if free is None else free)) // max(1, each)
    return max(1, min(wanted or cores or 1, fit, jobs))
