"""Staging folder of a run that can be resumed.

Unlike those of other outputs (files/output.py), an interrupted run's hidden folder is kept.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from matcap.brdf.folder import MEANINGS, mapset_files, preview_name
from matcap.errors import MatcapError
from matcap.files.cluster import WorkerLost
from matcap.files.names import StagedFolder, plain_name
from matcap.files.output import Output

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
