"""Workspace of a batch in its output folder: staging, claims of concurrent runs, known failures.

OUT/leather/                      a material, complete or absent
OUT/.matcap-batch/runs/RUN/       staged and replaced folders of one run
OUT/.matcap-batch/runs/RUN.alive  locked while the run's process lives
OUT/.matcap-batch/claims/NAME     locked by the run that makes a material
OUT/.matcap-batch/failed/NAME     a sample that cannot be used, and why

The system releases locks when a process ends, however it ends: a dead run is always recognised.
Which materials are done is decided by record.py alone. On file systems without locks two runs may
make the same material, and files of dead runs remain.

A material is published by renaming its staged folder, whose files are synced to disk before
(record.py). After a power cut the name is the old folder or the new one, complete; or missing, if
the cut was between the two renames of a replacement, and then the next run restores the old one.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from matcap.batch.input_folder import WORKSPACE
from matcap.batch.record import FILE as RECORD
from matcap.batch.record import read_record
from matcap.capture.outputs import output_files
from matcap.files.document import read_document
from matcap.files.output import sync, write_error

_SWAPS = 16  # attempts to rename while another run renames to the same name


@dataclass(frozen=True)
class Run:
    """One process's run of a batch: its staging folder and the locks it holds in the output."""

    out: Path
    """The output folder."""
    folder: Path
    """The run's own folder below it."""
    claims: dict[str, FileLock] = field(default_factory=dict, compare=False, repr=False)
    """Locks of the materials it makes, by name; not sent to workers."""

    def __reduce__(self) -> tuple[object, ...]:
        return Run, (self.out, self.folder)

    def stage(self, name: str) -> Path:
        """Create an empty staging folder with the material's name, on the output's file system."""
        parent = self.folder / "stage" / uuid.uuid4().hex
        stage = parent / name
        stage.mkdir(parents=True)
        return stage

    def publish(self, stage: Path) -> Path:
        """Rename a staged folder to its name in the output, replacing an existing one.

        Files that matcap did not write are moved to the new folder. The name is missing between
        two renames, and never holds part of a material. Of two runs at once, the last one wins.

        Raises:
            OSError: the output cannot be written.
        """
        final = self.out / stage.name
        moved: list[Path] = []
        try:
            for last in reversed(range(_SWAPS)):
                try:
                    os.rename(stage, final)
                    break
                except OSError as error:
                    if last == 0 or error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                        raise
                old = self.folder / "old" / uuid.uuid4().hex / stage.name
                old.parent.mkdir(parents=True)
                sync(old.parent.parent.parent)
                sync(old.parent.parent)
                with suppress(FileNotFoundError):
                    os.rename(final, old)
                    moved.append(old)
        except BaseException:
            # Restore the replaced folder, unless another run has taken the name.
            for old in reversed(moved):
                with suppress(OSError):
                    os.rename(old, final)
            raise
        sync(self.out)
        for old in moved:
            _keep_foreign(old, final)
            shutil.rmtree(old.parent, ignore_errors=True)
        with suppress(OSError):
            stage.parent.rmdir()
        return final

    def claim(self, name: str) -> bool:
        """Claim a material for this run; False if another running batch has it."""
        if name in self.claims:
            return True
        folder = self.out / WORKSPACE / "claims"
        folder.mkdir(parents=True, exist_ok=True)
        lock = _acquired(folder / name)
        if lock is not None:
            self.claims[name] = lock
        return lock is not None

    def release(self, name: str) -> None:
        """Release a claim of this run."""
        lock = self.claims.pop(name, None)
        if lock is not None:
            Path(lock.lock_file).unlink(missing_ok=True)
            lock.release()

    def write_failure(self, name: str, about: Mapping[str, Any]) -> None:
        """Record that a sample cannot be used."""
        folder = self.out / WORKSPACE / "failed"
        folder.mkdir(parents=True, exist_ok=True)
        mine = self.folder / f"failed-{uuid.uuid4().hex}"
        mine.write_text(json.dumps(dict(about)), encoding="utf-8")
        os.replace(mine, folder / name)

    def forget_failure(self, name: str) -> None:
        """Remove the record of a failure."""
        (self.out / WORKSPACE / "failed" / name).unlink(missing_ok=True)


def read_failure(out: Path, name: str) -> dict[str, Any] | None:
    """The record of a sample that could not be used; None without one."""
    return read_document(out / WORKSPACE / "failed" / name)


@contextmanager
def open_run(out: Path) -> Iterator[Run]:
    """Create a workspace for the `with` block; first cleans up after dead runs.

    Raises:
        MatcapError: the output folder cannot be created or written.
    """
    folder = out / WORKSPACE / "runs" / f"{os.getpid()}-{uuid.uuid4().hex[:12]}"
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        alive = _acquired(_alive(folder))  # before the folder exists, which others may clean up
        folder.mkdir()
    except OSError as error:
        raise write_error(out, error) from error
    for other in folder.parent.iterdir():
        if other != folder and other.is_dir():
            # A dead run's lock is free.
            with suppress(OSError, NotImplementedError), FileLock(_alive(other), timeout=0):
                _clear(out, other)
                _alive(other).unlink(missing_ok=True)
    run = Run(out, folder)
    try:
        yield run
    finally:
        with suppress(OSError):
            for name in list(run.claims):
                run.release(name)
        _clear(out, folder)
        _alive(folder).unlink(missing_ok=True)
        if alive is not None:
            alive.release()


def _acquired(path: Path) -> FileLock | None:
    """Acquire a lock; None if another process has it. Without lock support, always acquired."""
    lock = FileLock(path, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        return None
    except NotImplementedError:
        pass
    return lock


def _alive(run: Path) -> Path:
    """The lock file of a run."""
    return run.with_name(f"{run.name}.alive")


def _clear(out: Path, run: Path) -> None:
    """Restore folders that a run had moved to replace them, and delete its workspace."""
    for old in sorted(run.glob("old/*/*")):
        final = out / old.name
        try:
            if final.exists():
                _keep_foreign(old, final)
            else:
                os.rename(old, final)
        except OSError:
            return  # the next run tries again
    shutil.rmtree(run, ignore_errors=True)


def _keep_foreign(old: Path, new: Path) -> None:
    """Move files that matcap did not write from the replaced folder to the new one."""
    record = read_record(old)
    ours = {RECORD, *output_files(old.name)}
    ours |= {file.split("/")[0] for file in record["files"]} if record else set()
    for file in old.iterdir():
        if file.name not in ours and not (new / file.name).exists():
            os.rename(file, new / file.name)
