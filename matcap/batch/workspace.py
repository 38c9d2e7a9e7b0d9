"""Workspace of a batch in its output folder: staging, the lock of a run, known failures.

OUT/leather/                     a material, complete or absent
OUT/.matcap-batch/lock           held by the run that writes here, one at a time
OUT/.matcap-batch/run/           staged and replaced folders of that run
OUT/.matcap-batch/failed/NAME    a sample that cannot be used, and why

The system releases the lock when a process ends, however it ends; the next run then restores what
it had moved. Which materials are done is decided by record.py alone.

A material is published by renaming its staged folder, whose files are synced to disk before
(record.py). After a power cut the name is the old folder or the new one, complete; or missing, if
the cut was between the two renames of a replacement, and then the next run restores the old one.
"""

from __future__ import annotations

import json
import os
import shutil
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from matcap.batch.input_folder import WORKSPACE
from matcap.batch.record import FILE as RECORD
from matcap.batch.record import read_record
from matcap.capture.outputs import output_files
from matcap.errors import MatcapError
from matcap.files.document import read_document
from matcap.files.output import sync, write_error


@dataclass(frozen=True)
class Run:
    """The run of a batch that writes into an output folder."""

    out: Path
    """The output folder."""

    @property
    def folder(self) -> Path:
        """Its staged and replaced folders."""
        return self.out / WORKSPACE / "run"

    def stage(self, name: str) -> Path:
        """Create an empty staging folder with the material's name, on the output's file system."""
        stage = self.folder / "stage" / uuid.uuid4().hex / name
        stage.mkdir(parents=True)
        return stage

    def publish(self, stage: Path) -> Path:
        """Rename a staged folder to its name in the output, replacing an existing one.

        Files that matcap did not write are moved to the new folder. The name is missing between
        two renames, and never holds part of a material.

        Raises:
            OSError: the output cannot be written.
        """
        final = self.out / stage.name
        old = self.folder / "old" / uuid.uuid4().hex / stage.name
        if final.is_dir():
            old.parent.mkdir(parents=True)
            for folder in (self.folder, old.parent.parent):
                sync(folder)
            os.rename(final, old)
        try:
            os.rename(stage, final)
        except BaseException:
            if old.exists():
                os.rename(old, final)
            raise
        sync(self.out)
        if old.exists():
            _keep_foreign(old, final)
            shutil.rmtree(old.parent, ignore_errors=True)
        with suppress(OSError):
            stage.parent.rmdir()
        return final

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
    """Create a workspace for the `with` block; first cleans up after a run that was killed.

    Raises:
        MatcapError: another batch writes into the folder, or it cannot be created or written.
    """
    run, lock = Run(out), FileLock(out / WORKSPACE / "lock", timeout=0)
    try:
        run.folder.parent.mkdir(parents=True, exist_ok=True)
        with suppress(NotImplementedError):  # a file system without locks
            lock.acquire()
        _clear(run)
        run.folder.mkdir(exist_ok=True)
    except Timeout as error:
        raise MatcapError.at(
            out, "another matcap batch writes into this folder", "wait for it, or give another -o"
        ) from error
    except OSError as error:
        raise write_error(out, error) from error
    try:
        yield run
    finally:
        _clear(run)
        lock.release()


def _clear(run: Run) -> None:
    """Restore folders that a run had moved to replace them, and delete its workspace."""
    for old in sorted(run.folder.glob("old/*/*")):
        final = run.out / old.name
        try:
            if final.exists():
                _keep_foreign(old, final)
            else:
                os.rename(old, final)
        except OSError:
            return  # the next run tries again
    shutil.rmtree(run.folder, ignore_errors=True)


def _keep_foreign(old: Path, new: Path) -> None:
    """Move files that matcap did not write from the replaced folder to the new one."""
    record = read_record(old)
    ours = {RECORD, *output_files(old.name)}
    ours |= {file.split("/")[0] for file in record["files"]} if record else set()
    for file in old.iterdir():
        if file.name not in ours and not (new / file.name).exists():
            os.rename(file, new / file.name)
