"""Writes a rectangle of any size to files, in memory that does not grow with its size.

    blocks -> tiles (in the workers) -> one file a map, tile by tile -> mip levels, PNGs, preview
           -> published together

The request alone determines the order of the tiles. An interrupted run is resumed after its last
whole tile, and its files have the same bytes as those of an uninterrupted one.

Read next: plan.py, workers.py, exr_tiles.py.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from matcap.brdf.folder import preview_name
from matcap.files.output import check_output, check_writable
from matcap.synth.assembly import Assembly, assembly
from matcap.synth.jobs import BlockResult, Job, WorkerPool
from matcap.synth.levels import write_levels
from matcap.synth.plan import (
    PlannedMapSet,
    bytes_of,
    check_request,
    document_of,
    key_of,
    mapsets_of,
)
from matcap.synth.preview import PreviewPicture
from matcap.synth.request import SynthProgress, SynthRequest, Work
from matcap.synth.strips import height_coding, write_pngs
from matcap.synth.unfinished import files_of, unfinished, unfinished_bytes
from matcap.synth.workers import worker_pool

if TYPE_CHECKING:
    from matcap.field.blocks import BlockPart
    from matcap.field.source import Source
    from matcap.synth.fields import OpenedField


def write_field(
    request: SynthRequest, field: OpenedField, folder: str | Path, work: Work | None = None
) -> Path:
    """Write a rectangle of a field as a map set or a texture set; return the path of its JSON file.

    All files appear together, or none. If the run is interrupted, or the disk is full, or a worker
    is killed, the finished tiles stay in a hidden folder for `work.resume`.

    Raises:
        UsageError: an empty or too large rectangle, a bad name, a texture set out of range, or a
            cluster with a source on CUDA.
        MatcapError: files that must not be overwritten, a full disk, an unwritable folder, another
            run writing there, a run of other settings to resume, a killed worker, values that are
            not finite.
    """
    name, source = field.info.name, field.source
    check_request(request, name)
    work = work or Work()
    work.check(source.device_type)
    folder = Path(folder)
    outputs = [folder / file for file in files_of(folder, name)]
    check_output(outputs, inputs=work.inputs, overwrite=work.overwrite)
    left = unfinished_bytes(folder, name) if work.resume else 0
    check_writable(folder, max(bytes_of(request) - left, 0), files_of(folder, name))
    mapsets = mapsets_of(request, field)
    with (
        unfinished(folder, name, key_of(request, field), resume=work.resume) as stage,
        ExitStack() as stack,
    ):
        clock = _Clock(request.whole.width * request.whole.height, work.progress)
        blocks = sum(1 for mapset in mapsets for _ in mapset.parts(source))
        pool = stack.enter_context(worker_pool(source, work.workers, blocks, work.scheduler))
        sets = []
        preview = mapsets[0].preview
        shown = None if preview is None else PreviewPicture(preview)
        for mapset in mapsets:
            files = stack.enter_context(assembly(stage, mapset.pictures))
            for part, result in _missing(source, mapset, files, pool, clock):
                files.add(result.pictures)
                if shown is not None and result.lit is not None:
                    shown.add(mapset.area, part, result.lit)
            for picture, file in zip(mapset.pictures, files.files, strict=True):
                write_levels(picture, file, work.workers)
                file.finish()
            sets.append(files)
        heights = height_coding(sets) if request.png else None
        if heights is not None:
            for files in sets:
                write_pngs(stage, files, heights)
        document = document_of(request, field, heights)
        if shown is not None:
            (stage / preview_name(name)).write_bytes(shown.encoded())
        text = json.dumps(document, indent=2, allow_nan=False, default=str)
        (stage / f"{name}.json").write_text(text + "\n")
    return folder / f"{name}.json"


def _missing(
    source: Source, mapset: PlannedMapSet, files: Assembly, pool: WorkerPool, clock: _Clock
) -> Iterator[tuple[BlockPart, BlockResult]]:
    """Compute the parts of a map set that a resumed run lacks, and those that its preview shows."""

    def missing() -> Iterator[Job]:
        for part in mapset.parts(source):
            if files.lacks(part) or mapset.shows(part):
                yield part, mapset
            else:
                clock.count(skipped=part.texels)

    for (part, _), result in pool.run(missing()):
        yield part, result
        clock.count(part.texels)


class _Clock:
    """Counts texels and reports progress."""

    def __init__(self, total: int, on_progress: Callable[[SynthProgress], None]) -> None:
        self._total, self._on_progress = total, on_progress
        self._written = self._skipped = 0
        self._start = time.monotonic()

    def count(self, written: int = 0, skipped: int = 0) -> None:
        """Count texels that are written now, or that an interrupted run had written; report."""
        self._written += written
        self._skipped += skipped
        seconds, done = time.monotonic() - self._start, self._written + self._skipped
        rate = self._written / max(seconds, 1e-9)
        left = (self._total - done) / rate if rate else None
        self._on_progress(SynthProgress("", done / self._total, seconds, left, rate))
