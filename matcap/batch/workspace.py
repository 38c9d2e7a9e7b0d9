"""Where a batch works: beside its output, in folders that appear in their place by renaming.

    OUT/leather/                   a material; complete, or not there
    OUT/.matcap-batch/runs/RUN/    one run's own: `alive`, and what it is making or replacing
    OUT/.matcap-batch/claims/NAME  who is making a material, so that two runs do not both
    OUT/.matcap-batch/failed/NAME  photographs that cannot be used, and why

Nothing here is trusted for what is done (that is record.py): a claim only saves work, and one
whose run is dead counts for nothing. A run is dead when its process is gone, or when it has not
touched `alive` for a minute (another machine, whose processes cannot be seen).
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import socket
import threading
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matcap.batch.record import FILE as RECORD
from matcap.batch.record import read_record
from matcap.batch.shoot import WORKSPACE
from matcap.capture.outputs import output_files
from matcap.files.publish import sync
from matcap.files.staging import write_error

_BEAT = 5.0  # seconds between two touches of `alive`
_SILENT = 60.0  # seconds after which a run's claims lapse
_LOST = 24 * 3600.0  # seconds after which a silent run of another machine is cleared away
_SWAPS = 16  # tries to take a name that another run takes at the same moment


@dataclass(frozen=True)
class Run:
    """One run's place.

    Attributes:
        out: the output folder.
        folder: the run's own, below it.
    """

    out: Path
    folder: Path

    def stage(self, name: str) -> Path:
        """An empty folder called as the material, on the same disk as the output."""
        parent = self.folder / "stage" / uuid.uuid4().hex
        stage = parent / name
        stage.mkdir(parents=True)
        return stage

    def publish(self, stage: Path) -> Path:
        """Give a finished stage its name in the output; what stood there makes room.

        Files that nobody remembers writing move to the new folder. The name is missing for a
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
        claims = self.out / WORKSPACE / "claims"
        claim, mine = claims / name, self.folder / f"claim-{uuid.uuid4().hex}"
        claims.mkdir(parents=True, exist_ok=True)
        mine.write_text(self.folder.name)
        try:
            try:
                os.link(mine, claim)
                return True
            except FileExistsError:
                pass
            except OSError:  # a file system without links: two runs may both make it, no harm
                if not claim.exists():
                    os.replace(mine, claim)
                    return True
            owner = _text(claim)
            if owner == self.folder.name:
                return True
            if owner and _is_alive(self.folder.parent / owner):
                return False
            os.replace(mine, claim)
            return _text(claim) == self.folder.name
        finally:
            mine.unlink(missing_ok=True)

    def release(self, name: str) -> None:
        """Take a claim back; one that another run has taken over stays."""
        claim = self.out / WORKSPACE / "claims" / name
        if _text(claim) == self.folder.name:
            claim.unlink(missing_ok=True)

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
        found = json.loads((out / WORKSPACE / "failed" / name).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


@contextmanager
def open_run(out: Path) -> Iterator[Run]:
    """A place to work in while the block runs; clears away what dead runs left.

    Raises:
        MatcapError: the output folder cannot be made or written.
    """
    folder = out / WORKSPACE / "runs" / f"{os.getpid()}-{uuid.uuid4().hex[:12]}"
    try:
        folder.mkdir(parents=True)
        _describe(folder)
    except OSError as error:
        raise write_error(out, error) from error
    _clear_dead(out, folder)
    stop = threading.Event()
    heart = threading.Thread(target=_beat, args=(folder / "alive", stop), daemon=True)
    heart.start()
    try:
        yield Run(out, folder)
    finally:
        stop.set()
        heart.join()
        _clear(out, folder)
        with suppress(OSError):
            _drop_stale_claims(out, folder.name)


def _describe(folder: Path) -> None:
    """Write `alive` at once and whole: who this run is."""
    new = folder / "new"
    new.write_text(json.dumps({"host": _host(), "pid": os.getpid()}))
    os.replace(new, folder / "alive")


def _host() -> str:
    """This machine, and the space its process numbers are of (containers share names)."""
    try:
        space = os.readlink("/proc/self/ns/pid")
    except OSError:
        space = ""
    return f"{socket.gethostname()} {space}".strip()


def _beat(alive: Path, stop: threading.Event) -> None:
    while not stop.wait(_BEAT):
        with suppress(OSError):
            os.utime(alive)


def _is_alive(run: Path, silent: float = _SILENT) -> bool:
    try:
        age = time.time() - (run / "alive").stat().st_mtime
        about = json.loads((run / "alive").read_text())
        host, pid = str(about["host"]), int(about["pid"])
    except FileNotFoundError:
        return _is_young(run)  # it has not got as far as saying so
    except (OSError, ValueError, KeyError, TypeError):
        return False
    if host == _host() and not _exists(pid):
        return False
    return age < silent


def _is_young(folder: Path) -> bool:
    try:
        return time.time() - folder.stat().st_mtime < _BEAT
    except OSError:
        return False


def _exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True  # it exists and is not ours
    return True


def _clear_dead(out: Path, mine: Path) -> None:
    """Clear away what dead runs left."""
    for run in mine.parent.iterdir():
        if run != mine and not _is_alive(run, _LOST):
            _clear(out, run)


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


def _drop_stale_claims(out: Path, run: str) -> None:
    for claim in (out / WORKSPACE / "claims").iterdir():
        if _text(claim) == run:
            claim.unlink(missing_ok=True)


def _keep_foreign(old: Path, new: Path) -> None:
    """Move files that matcap did not write from an old folder to the new one."""
    record = read_record(old)
    ours = {RECORD, *output_files(old.name)}
    ours |= {file.split("/")[0] for file in record["files"]} if record else set()
    for file in old.iterdir():
        if file.name not in ours and not (new / file.name).exists():
            os.rename(file, new / file.name)


def _text(file: Path) -> str:
    try:
        return file.read_text()
    except (OSError, ValueError):
        return ""
