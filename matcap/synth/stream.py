"""Writes a rectangle of any size to files, in memory that does not grow with its size.

    blocks -> texels (in the workers) -> a file of plain numbers -> EXR files with mip levels, PNGs,
           preview -> published together

An interrupted run is resumed with the blocks that it had, and its files have the same bytes as
those of an uninterrupted one.

Read next: plan.py, workers.py, assembly.py, pictures.py.
"""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from matcap.brdf.folder import preview_name
from matcap.files.output import check_output, check_writable
from matcap.synth.assembly import Assembly
from matcap.synth.jobs import BlockResult, Job, WorkerPool
from matcap.synth.pictures import height_coding, texel_type, write_map, write_png
from matcap.synth.plan import (
    PlannedMapSet,
    bytes_of,
    check_request,
    document_of,
    key_of,
    mapsets_of,
    wrap_modes,
)
from matcap.synth.preview import PreviewPicture
from matcap.synth.request import SynthProgress, SynthRequest, Work
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
    is killed, the finished blocks stay in a hidden folder for `work.resume`.

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
    kind, wrap = texel_type(source.specular_channels), wrap_modes(request, source)
    blocks = sum(1 for mapset in mapsets for _ in mapset.parts(source))
    with (
        unfinished(folder, name, key_of(request, field), resume=work.resume) as stage,
        worker_pool(source, work.workers, blocks, work.scheduler) as pool,
        ThreadPoolExecutor(work.workers) as writers,
    ):
        clock = _Clock(request.whole.width * request.whole.height, work.progress)
        preview = mapsets[0].preview
        shown = None if preview is None else PreviewPicture(preview)
        for number, mapset in enumerate(mapsets):
            size = (mapset.area.width, mapset.area.height)
            with closing(Assembly(stage / f".{number}.texels", size, kind)) as texels:
                for index, part, result in _missing(source, mapset, texels, pool, clock):
                    texels.add(index, part, result.texels)
                    if shown is not None and result.lit is not None:
                        shown.add(mapset.area, part, result.lit)
                if not texels.written:
                    write = partial(_write_map, stage, texels, wrap)
                    list(writers.map(write, mapset.files.items()))
                texels.finish()
        heights = None
        if request.png:
            heights = height_coding([stage / mapset.files["height"] for mapset in mapsets])
            for map_kind, file in (one for mapset in mapsets for one in mapset.files.items()):
                write_png(stage / file, map_kind, heights)
        document = document_of(request, field, heights)
        if shown is not None:
            (stage / preview_name(name)).write_bytes(shown.encoded())
        text = json.dumps(document, indent=2, allow_nan=False, default=str)
        (stage / f"{name}.json").write_text(text + "\n")
    return folder / f"{name}.json"


def _write_map(stage: Path, texels: Assembly, wrap: str, named: tuple[str, str]) -> None:
    kind, file = named
    write_map(stage / file, kind, texels, wrap)


def _missing(
    source: Source, mapset: PlannedMapSet, texels: Assembly, pool: WorkerPool, clock: _Clock
) -> Iterator[tuple[int, BlockPart, BlockResult]]:
    """Compute the parts of a map set that a resumed run lacks, and those that its preview shows."""
    indices = deque[int]()

    def missing() -> Iterator[Job]:
        for index, part in enumerate(mapset.parts(source)):
            if mapset.shows(part) or not texels.has(index, part):
                indices.append(index)
                yield part, mapset
            else:
                clock.count(skipped=part.texels)

    for (part, _), result in pool.run(missing()):
        yield indices.popleft(), part, result
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
