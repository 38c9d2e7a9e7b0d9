"""Writes a rectangle of any size to files, in bounded memory, resumably."""

from __future__ import annotations

import json
import pickle
import shutil
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from filelock import FileLock, Timeout
from numpy.typing import NDArray

from matcap.brdf.folder import MEANINGS, mapset_files, preview_name
from matcap.errors import MatcapError
from matcap.field.plane import BlockPart
from matcap.files.names import StagedFolder, plain_name
from matcap.files.output import Output, check_output, check_writable
from matcap.files.process import (
    RemoteResult,
    WorkerLost,
    dask_client,
    dask_threads,
    keep_memory,
    settle_child,
    starting_children,
)
from matcap.files.threads import compute_alone, single_threaded
from matcap.synth.pictures import (
    Assembly,
    PreviewPicture,
    height_coding,
    lit_from_top,
    texel_type,
    texels_of,
    write_map,
    write_png,
)
from matcap.synth.plan import (
    PlannedMapSet,
    bytes_of,
    check_request,
    document_of,
    key_of,
    mapsets_of,
    open_field,
    wrap_modes,
)
from matcap.synth.request import SynthProgress, SynthRequest, Work

if TYPE_CHECKING:
    from matcap.field.source import Source
    from matcap.synth.plan import OpenedField


# Runs blocks of a field as jobs of a worker pool, in order, a bounded number at a time.


@dataclass(frozen=True)
class BlockResult:
    """Result of a job."""

    texels: NDArray[np.void]
    """(rows, columns) texels of the part, in the files' precision."""
    lit: NDArray[np.float16] | None
    """(rows, columns, 3) radiance of the part under a light, if the preview shows it."""


# A part of a block, and the map set that it is written to.
Job = tuple[BlockPart, PlannedMapSet]
RunningJob = Future[BlockResult] | RemoteResult
Submit = Callable[[Job], RunningJob]


@dataclass(frozen=True)
class WorkerPool:
    """Running workers."""

    submit: Submit
    ahead: int
    """Most jobs in flight."""

    def run(self, jobs: Iterable[Job]) -> Iterator[tuple[Job, BlockResult]]:
        """Run the jobs; yield each with its result, in order.

        Raises:
            MatcapError: raised by a job.
            WorkerLost: a worker process was killed.
        """
        pending: deque[tuple[Job, RunningJob]] = deque()
        try:
            for job in jobs:
                pending.append((job, self.submit(job)))
                if len(pending) >= self.ahead:
                    yield _first(pending)
            while pending:
                yield _first(pending)
        except BrokenProcessPool as error:
            raise WorkerLost(
                "a worker process was killed",
                remedy="free some memory or ask for fewer with -j, and go on with --resume",
            ) from error
        finally:
            for _, result in pending:
                result.cancel()


def rendered(source: Source, job: Job) -> BlockResult:
    """Compute the job's part of a block, and light what is shown.

    Raises:
        MatcapError: a value is not finite, or too large for half float.
    """
    part, mapset = job
    planes = source.planes(part.block, mapset.normal)[(..., *part.source)]
    texels = texels_of(planes, source.specular_channels)
    return BlockResult(texels, lit_from_top(planes, mapset.normal) if mapset.shows(part) else None)


@lru_cache(maxsize=2)
def unpacked(packed: bytes) -> Source:
    """Unpickle a source; the last two are cached."""
    return pickle.loads(packed)


def _first(pending: deque[tuple[Job, RunningJob]]) -> tuple[Job, BlockResult]:
    job, result = pending.popleft()
    return job, result.result()


# Worker pool that computes blocks: threads, processes, or a Dask cluster; field/source.py says why
# one thread a block.

_AHEAD = 2  # blocks in flight for each worker: one computed, one waiting
_FEW = 24  # up to so many blocks, threads are done before processes have started


@contextmanager
def worker_pool(
    source: Source, workers: int, jobs: int, scheduler: str | None = None
) -> Iterator[WorkerPool]:
    """Context of a worker pool: a cluster, processes, or threads for few jobs and on CUDA.

    Threads share a CUDA device, and encode tiles in parallel.

    Args:
        workers: number of processes or threads.
        jobs: upper bound of the number of jobs.
        scheduler: address of a Dask scheduler, whose workers are used instead.

    Raises:
        MatcapError: no scheduler answers, or Dask is not installed.
    """
    if scheduler is not None:
        with dask_client(scheduler) as client:
            shared_source = client.scatter(pickle.dumps(source), broadcast=True, hash=False)
            submit = partial(RemoteResult, client, _render_alone, shared_source)
            yield WorkerPool(submit, _AHEAD * dask_threads(client))
    elif workers == 1 or jobs <= _FEW or source.device_type != "cpu":
        with single_threaded(workers) as pool:
            yield WorkerPool(lambda job: pool.submit(rendered, source, job), _AHEAD * workers)
    else:
        processes = ProcessPoolExecutor(
            workers,
            mp_context=get_context("spawn"),
            initializer=_prepare,
            initargs=(pickle.dumps(source),),
        )
        try:
            yield WorkerPool(partial(_submit, processes), _AHEAD * workers)
        finally:
            processes.shutdown(cancel_futures=True)


def _submit(processes: ProcessPoolExecutor, job: Job) -> RunningJob:
    """Submit a job to a pool, which may start a process for it."""
    with starting_children():
        return processes.submit(_render_here, job)


def _render_alone(packed: bytes, job: Job) -> BlockResult:
    """Run a job on one thread of a cluster's worker."""
    with single_threaded(1) as pool:
        return pool.submit(rendered, unpacked(packed), job).result()


def _render_here(job: Job) -> BlockResult:
    """Run a job in a worker process."""
    return rendered(_task[0], job)


# The source, in a worker process; empty in any other.
_task: list[Source] = []


def _prepare(packed: bytes) -> None:
    """Set up a worker process: one thread, kept memory, and exit with its parent."""
    compute_alone()
    _task.append(unpacked(packed))
    keep_memory()
    settle_child()


# Staging folder of a run that can be resumed.
#
# Unlike those of other outputs (files/output.py), an interrupted run's hidden folder is kept.

_KEY, _LOCK = ".request", ".lock"


@contextmanager
def unfinished(folder: Path, name: str, key: str, *, resume: bool) -> Iterator[StagedFolder]:
    """Context of a folder to write into, whose files are moved to `folder` on exit.

    After an interruption, a full disk or a killed worker the staging folder is kept; after any
    other error it is removed.

    Args:
        folder: destination; created if missing.
        key: plan.key_of of the request: a digest, a space, the device.
        resume: keep the files of an interrupted run; otherwise remove them.

    Raises:
        MatcapError: another run is writing these maps, the interrupted run had another key, the
            disk is full, or the folder cannot be written.
    """
    output = Output(folder, files_of(folder, name))
    with output.stage(_stage_name(name)) as stage, _locked(stage):
        keep = True
        try:
            _open(stage, key, resume=resume)
            yield stage
            names = [file.name for file in stage.iterdir() if not file.name.startswith(".")]
            output.publish(stage, names)
            keep = False
        except Exception as error:
            keep = isinstance(error, (OSError, WorkerLost))
            raise
        finally:
            if not keep:
                shutil.rmtree(stage, ignore_errors=True)


def unfinished_bytes(folder: Path, name: str) -> int:
    """Bytes that an interrupted run left in its staging folder."""
    stage = folder / _stage_name(name)
    return sum(file.stat().st_size for file in stage.glob("*") if file.is_file())


def _stage_name(name: str) -> str:
    return f".{plain_name(name)}.matcap-part"


@contextmanager
def _locked(stage: Path) -> Iterator[None]:
    lock = FileLock(stage / _LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout as error:
        raise MatcapError.at(
            stage.parent,
            "another matcap is writing these maps",
            "wait for it, or choose another folder with -o",
        ) from error
    try:
        yield
    finally:
        lock.release()


def _open(stage: Path, key: str, *, resume: bool) -> None:
    """Check that the staged files belong to this request; without `resume` remove them."""
    file = stage / _KEY
    begun = file.read_text() if resume and file.exists() else key
    before, now = (one.partition(" ")[2] for one in (begun, key))
    if before not in ("", now):
        raise MatcapError.at(
            stage,
            f"the unfinished maps here were begun on {before}; {now} rounds differently",
            f"give --device {before}, or leave --resume out to begin anew",
        )
    if begun != key:
        raise MatcapError.at(
            stage,
            "the unfinished maps here were begun with another material or other settings",
            "repeat the command that began them, or leave --resume out to begin anew",
        )
    if not resume or not file.exists():
        for old in stage.iterdir():
            if old.name != _LOCK:
                old.unlink()
        file.write_text(key)


def files_of(folder: Path, name: str) -> list[str]:
    """Possible file names of a map set or texture set of this name; UDIM tiles by what exists."""
    tiles = [
        file.name for kind in MEANINGS for file in folder.glob(f"{name}_{kind}.1[0-9][0-9][0-9].*")
    ]
    return [*mapset_files(name), preview_name(name), *tiles]


# Writes a rectangle of any size to files, in memory that does not grow with its size.
#
# blocks -> texels (in the workers) -> a file of plain numbers -> EXR files with mip levels, PNGs,
# preview -> published together
#
# An interrupted run is resumed with the blocks that it had, and its files have the same bytes as
# those of an uninterrupted one.
#
# Read next: plan.py, pictures.py.


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
                written = {} if texels.written else mapset.files
                for done in [
                    writers.submit(write_map, stage / file, map_kind, texels, wrap)
                    for map_kind, file in written.items()
                ]:
                    done.result()
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


# Synthesise a rectangle of a material's field to files: `matcap synth`, for Python.
#
# PyTorch is imported only where it is needed: a material with an exemplar does not need it, and
# importing it takes longer than synthesising a map.


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
