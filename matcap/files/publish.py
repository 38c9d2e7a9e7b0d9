"""Atomic commit of several files to a folder, by undo logging [gray1993, ch. 9].

The journal is a hidden folder in the destination, which keeps the old files:

    1. sync the new files
    2. write and sync the journal: the list of names, and hard links to the old files
    3. rename the new files into place, remove old ones that are not replaced, and sync
    4. delete the list, which commits

Before step 4 the old files can be restored from the journal (_roll_back): at once if a step fails,
and after a power cut by the next run (recover). A lock keeps other processes from publishing into
the same folder. A single file is committed by its renaming alone. The need to sync: [pillai2014].

Read next: staging.py, where the new files are made.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

HIDDEN = ".matcap-"  # prefix of the names of hidden folders
JOURNAL = f"{HIDDEN}journal"
_LIST = "list.json"


def publish(stage: Path, names: Iterable[str], folder: Path, *, replacing: Iterable[str]) -> None:
    """Move finished files from their stage to a folder, all or none.

    Args:
        stage: folder with the files, on the same disk as `folder`; restored after a failure.
        names: of the files; JSON documents are moved last, after the files that they name.
        folder: destination, which exists.
        replacing: names of older files in `folder` to remove.

    Raises:
        OSError: with the name of the file; nothing has changed then.
    """
    fresh = sorted(set(names), key=lambda name: (name.endswith(".json"), name))
    with _locked(folder):
        _roll_back(folder)
        old = [name for name in dict.fromkeys([*fresh, *replacing]) if _file_exists(folder / name)]
        for name in fresh:
            sync(stage / name)
        if len({*fresh, *old}) == 1 and fresh:
            os.replace(stage / fresh[0], folder / fresh[0])
            sync(folder)
        elif fresh or old:
            _exchange(stage, fresh, folder, old)


def recover(folder: Path) -> None:
    """Roll back a publication into a folder that was interrupted by a crash or a power cut.

    Raises:
        OSError: the folder cannot be written.
    """
    if os.path.lexists(folder / JOURNAL):
        with _locked(folder):
            _roll_back(folder)


def sync(path: Path) -> None:
    """Flush a file's content, or a folder's entries, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def refuse_folders(folder: Path, names: Iterable[str]) -> None:
    """Raise IsADirectoryError, with the path, if one of the names is a folder."""
    for name in names:
        _file_exists(folder / name)


def _exchange(stage: Path, fresh: list[str], folder: Path, old: list[str]) -> None:
    """Write the journal, rename the files and delete the list (steps 2 to 4 of the module)."""
    try:
        _write_journal(stage, fresh, folder, old)
        for name in fresh:
            os.replace(stage / name, folder / name)
        for name in set(old) - set(fresh):
            with suppress(FileNotFoundError):  # moved to the journal, without hard links
                os.unlink(folder / name)
        sync(folder)
        os.unlink(folder / JOURNAL / _LIST)
    except BaseException:
        _roll_back(folder)
        raise
    sync(folder / JOURNAL)
    shutil.rmtree(folder / JOURNAL, ignore_errors=True)


def _write_journal(stage: Path, fresh: list[str], folder: Path, old: list[str]) -> None:
    """Step 2: write and sync the journal."""
    journal = folder / JOURNAL
    os.mkdir(journal)
    about = {"stage": os.path.relpath(stage, folder), "fresh": fresh, "old": old}
    new = journal / "new"
    new.write_text(json.dumps(about))
    sync(new)
    os.replace(new, journal / _LIST)
    sync(journal)
    sync(folder)
    for name in old:
        try:
            os.link(folder / name, _backup(journal, name), follow_symlinks=False)
        except OSError:  # a file system without hard links
            os.replace(folder / name, _backup(journal, name))
    if old:
        sync(journal)


def _roll_back(folder: Path) -> None:
    """Restore the old files from the journal, if there is one."""
    journal = folder / JOURNAL
    try:
        about = _read_list(journal / _LIST)
    except (FileNotFoundError, NotADirectoryError, ValueError):
        # Not begun, or committed; or not a journal of ours.
        shutil.rmtree(journal, ignore_errors=True)
        return
    stage = folder / about["stage"]
    kept = [name for name in about["old"] if os.path.lexists(_backup(journal, name))]
    for name in about["fresh"]:
        untouched = name in about["old"] and name not in kept
        if not untouched and not os.path.lexists(stage / name):
            _move_back(folder / name, stage / name)
    for name in kept:
        os.replace(_backup(journal, name), folder / name)
    sync(folder)
    os.unlink(journal / _LIST)
    sync(journal)
    shutil.rmtree(journal, ignore_errors=True)


def _read_list(path: Path) -> dict[str, Any]:
    """Read the journal's list, whose names must be plain, so that no foreign file is moved.

    Raises:
        ValueError: the list is malformed.
    """
    about = json.loads(path.read_text())
    if not isinstance(about, dict) or set(about) != {"stage", "fresh", "old"}:
        raise ValueError("not a journal")
    if not isinstance(about["fresh"], list) or not isinstance(about["old"], list):
        raise ValueError("not a journal")
    for name in (about["stage"], *about["fresh"], *about["old"]):
        if not isinstance(name, str) or name in ("", ".", "..") or Path(name).name != name:
            raise ValueError(f"{name!r} is no name in this folder")
    return about


def _move_back(file: Path, staged: Path) -> None:
    """Move a new file back to its stage; delete it if the stage is gone."""
    with suppress(FileNotFoundError):
        if staged.parent.is_dir():
            os.replace(file, staged)
        else:
            os.unlink(file)


def _backup(journal: Path, name: str) -> Path:
    """Path of an old file in the journal; the suffix avoids the name of the list."""
    return journal / f"{name}.old"


def _file_exists(path: Path) -> bool:
    """Whether a file exists; raises IsADirectoryError for a folder."""
    if path.is_dir() and not path.is_symlink():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    return os.path.lexists(path)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Context in which no other process publishes into the folder."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
