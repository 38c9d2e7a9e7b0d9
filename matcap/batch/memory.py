"""Memory of one worker, and the number of workers that fit.

A sum of the libraries, the decoded photograph, a part proportional to the exemplar's texels and one
to the map set's. Measured on Linux, glibc (command in docs/notes/stability.md).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

from matcap.batch.settings import BatchSettings
from matcap.capture.rectified import UNION_TIMES
from matcap.files.memory import cores, free_bytes

_LIBRARIES = 1_150_000_000  # bytes, with the optimisation of one window
_BY_PIXEL = {"raw": 22, "other": 12}  # bytes a pixel of the file
_BY_TEXEL = 400  # bytes a texel of the exemplar, detail x 3/4 detail
_BY_MAP_TEXEL = 110  # bytes a texel of the map set
_USUAL_PIXELS = 12_000_000  # assumed where a file cannot be read
_SPARE = 0.85  # share of the free memory that workers may take
_RAW_FORMS = ("RAW", "DNG")


def worker_bytes(settings: BatchSettings, pixels: int, *, raw: bool) -> int:
    """Upper bound of a worker's memory, in bytes.

    Args:
        pixels: of the largest photograph.
        raw: whether that is a RAW file.
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
    """The largest worker_bytes over photographs."""
    sizes = [photo_pixels(photo) for photo in photos] or [(_USUAL_PIXELS, False)]
    return max(worker_bytes(settings, pixels, raw=raw) for pixels, raw in sizes)


def photo_pixels(path: Path) -> tuple[int, bool]:
    """Number of pixels by a file's header, and whether it is RAW; typical values if unreadable."""
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
                    warnings.simplefilter("ignore")  # Pillow's on large pictures
                    with Image.open(path) as picture:
                        return picture.width * picture.height, False
            except Image.DecompressionBombError:  # above Pillow's limit
                return MOST_PIXELS, False
    except Exception:
        return _USUAL_PIXELS, path.suffix.lower() not in (".jpg", ".jpeg", ".png")


def pool_size(wanted: int | None, each: int, jobs: int) -> int:
    """Number of workers: `wanted`, else the cores; at most what fits in memory, and `jobs`.

    Args:
        wanted: by the user, or None.
        each: bytes of a worker.
    """
    fit = int(_SPARE * free_bytes()) // max(1, each)
    return max(1, min(wanted or cores(), fit, jobs))
