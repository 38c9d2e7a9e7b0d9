"""Where a batch works: beside its output, in folders that appear in their place by renaming.

OUT/leather/                   a material; complete, or not there
OUT/.matcap-batch/runs/RUN/    one run's own: what it is making or replacing
OUT/.matcap-batch/runs/RUN.alive  locked while it lives
OUT/.matcap-batch/claims/NAME  who is making a material, so that two runs do not both
OUT/.matcap-batch/failed/NAME  photographs that cannot be used, and why

Both `RUN.alive` and claims are locked files: the system lets go of them when their process ends,
however it ends, so that a dead run is always recognised. Nothing here is trusted for what is done
(that is record.py): where a file system knows no locks, two runs may make one material twice, and
what dead runs left stays.

A power cut leaves what had its name before, whole, or the new one, whole: a folder's files reach
the disk before it is renamed (record.py). Between the two renames of a replacement the name is
missing; the next run gives it back to the old folder.
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

from matcap.batch.record import FILE as RECORD
from matcap.batch.record import read_record
from matcap.batch.shoot import WORKSPACE
from matcap.capture.outputs import output_files
from matcap.files.publish import sync
from matcap.files.staging import write_error

_SWAPS = 16  # tries to take a name that another run takes at the same moment


@dataclass(frozen=True)
class Run:
    """One run's place."""

    out: Path
    """The output folder."""
    folder: Path
    """The run's own, below it."""
    claims: dict[str, FileLock] = field(default_factory=dict, compare=False, repr=False)
    """What it makes; held by the process that claimed it, and not sent to workers."""

    def __reduce__(self) -> tuple[object, ...]:
        return Run, (self.out, self.folder)

    def stage(self, name: str) -> Path:
        """An empty folder called as the material, on the same disk as the output."""
        parent = self.folder / "stage" / uuid.uuid4().hex
        stage = parent / name
        stage.mkdir(parents=True)
        return stage

    def publish(self, stage: Path) -> Path:
        """Give a finished stage its name in the output; what stood there makes room.

        Files of unknown origin move to the new folder. The name is missing for a
        moment, and never holds part of a material. Of two runs at once, the last one stays.

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
            # What had made room comes back, unless another run has taken the name.
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
        """Say that this run makes a material; False when another living run does."""
        if name in self.claims:
            return True
        folder = self.out / WORKSPACE / "claims"
        folder.mkdir(parents=True, exist_ok=True)
        lock = _acquired(folder / name)
        if lock is not None:
            self.claims[name] = lock
        return lock is not None

    def release(self, name: str) -> None:
        """Take a claim back, if it is this run's."""
        lock = self.claims.pop(name, None)
        if lock is not None:
            Path(lock.lock_file).unlink(missing_ok=True)
            lock.release()

    def write_failure(self, name: str, about: Mapping[str, Any]) -> None:
        """Remember that a photograph cannot be used."""
        folder = self.out / WORKSPACE / "failed"
        folder.mkdir(parents=True, exist_ok=True)
        mine = self.folder / f"failed-{uuid.uuid4().hex}"
        mine.write_text(json.dumps(dict(about)), encoding="utf-8")
        os.replace(mine, folder / name)

    def forget_failure(self, name: str) -> None:
        """It can be used after all."""
        (self.out / WORKSPACE / "failed" / name).unlink(missing_ok=True)


def read_failure(out: Path, name: str) -> dict[str, Any] | None:
    """What is remembered of a photograph that could not be used."""
    try:
        record = json.loads((out / WORKSPACE / "failed" / name).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) else None


@contextmanager
def open_run(out: Path) -> Iterator[Run]:
    """A place to work in while the block runs; clears away what dead runs left.

    Raises:
        MatcapError: the output folder cannot be made or written.
    """
    folder = out / WORKSPACE / "runs" / f"{os.getpid()}-{uuid.uuid4().hex[:12]}"
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        alive = _acquired(_alive(folder))  # before there is a folder that others might clear away
        folder.mkdir()
    except OSError as error:
        raise write_error(out, error) from error
    for other in folder.parent.iterdir():
        if other != folder and other.is_dir():
            _clear_if_dead(out, other)
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
    """A lock that this process holds from here on; None where another does.

    Where the file system knows no locks everybody holds it.
    """
    lock = FileLock(path, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        return None
    except NotImplementedError:
        pass
    return lock


def _clear_if_dead(out: Path, run: Path) -> None:
    """Clear away what a dead run left."""
    lock = FileLock(_alive(run), timeout=0)
    with suppress(OSError, NotImplementedError), lock:
        _clear(out, run)
        _alive(run).unlink(missing_ok=True)


def _alive(run: Path) -> Path:
    """What is locked while a run lives; after a power cut it may be gone, and is made again."""
    return run.with_name(f"{run.name}.alive")


def _clear(out: Path, run: Path) -> None:
    """Put back what a run had moved away, and remove the rest of it."""
    for old in sorted(run.glob("old/*/*")):
        final = out / old.name
        try:
            if final.exists():
                _keep_foreign(old, final)
            else:
                os.rename(old, final)
        except OSError:
            return  # it stays for the next run
    shutil.rmtree(run, ignore_errors=True)


def _keep_foreign(old: Path, new: Path) -> None:
    """Move files that matcap did not write from an old folder to the new one."""
    record = read_record(old)
    ours = {RECORD, *output_files(old.name)}
    ours |= {file.split("/")[0] for file in record["files"]} if record else set()
    for file in old.iterdir():
        if file.name not in ours and not (new / file.name).exists():
            os.rename(file, new / file.name)
