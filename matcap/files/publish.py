"""Atomic commit of several files to a folder, with a write-ahead log against power cuts.

What makes room is kept in a journal, a hidden folder beside it, until all of the new stands:

    1. the new files reach the disk
    2. the journal: the list of names, and the old files by a second name; on the disk
    3. every new file takes its place, what belongs to the old alone goes; on the disk
    4. the list is deleted: from here on the new is whole

Before step 4 the journal puts the old back (`roll_back`): at once when a step fails, and after a
power cut when the next run comes by (`recover`). Only one process publishes into a folder at a
time. What several files promise a single one keeps by its renaming alone.

The method: undo logging (Gray and Reuter 1993, ch. 9). What a disk may
do to files that were not synced: Pillai et al. 2014.

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

HIDDEN = ".matcap-"  # how the names of stages begin
JOURNAL = f"{HIDDEN}journal"
_LIST = "list.json"


def publish(stage: Path, names: Iterable[str], folder: Path, *, replacing: Iterable[str]) -> None:
    """Move finished files from their stage to a folder, all or none.

    Args:
        stage: holds the files; on the same disk as `folder`. After a failure they are there again.
        names: of the files; documents come last, so that a reader of one finds what it names.
        folder: where they belong; it exists.
        replacing: names of older files in `folder` that go when the new ones come.

    Raises:
        OSError: with the name that was in the way; nothing has changed then.
    """
    fresh = sorted(set(names), key=lambda name: (name.endswith(".json"), name))
    with _alone(folder):
        _mend(folder)
        old = [name for name in dict.fromkeys([*fresh, *replacing]) if _stands(folder / name)]
        for name in fresh:
            sync(stage / name)
        if len({*fresh, *old}) == 1 and fresh:
            os.replace(stage / fresh[0], folder / fresh[0])
            sync(folder)
        elif fresh or old:
            _exchange(stage, fresh, folder, old)


def recover(folder: Path) -> None:
    """Put back what a run had moved that was cut off while it published into a folder.

    Raises:
        OSError: the folder cannot be written.
    """
    if os.path.lexists(folder / JOURNAL):
        with _alone(folder):
            _mend(folder)


def sync(path: Path) -> None:
    """Have a file's content, or a folder's names, reach the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def refuse_folders(folder: Path, names: Iterable[str]) -> None:
    """Raise IsADirectoryError, with its path, if a folder stands where a file is to be."""
    for name in names:
        _stands(folder / name)


def _exchange(stage: Path, fresh: list[str], folder: Path, old: list[str]) -> None:
    """Steps 2 to 4."""
    try:
        _keep(stage, fresh, folder, old)
        for name in fresh:
            os.replace(stage / name, folder / name)
        for name in set(old) - set(fresh):
            with suppress(FileNotFoundError):  # moved to the journal, where links are unknown
                os.unlink(folder / name)
        sync(folder)
        os.unlink(folder / JOURNAL / _LIST)
    except BaseException:
        _mend(folder)
        raise
    sync(folder / JOURNAL)
    shutil.rmtree(folder / JOURNAL, ignore_errors=True)


def _keep(stage: Path, fresh: list[str], folder: Path, old: list[str]) -> None:
    """Step 2: the journal of what is about to change, on the disk."""
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
            os.link(folder / name, _aside(journal, name), follow_symlinks=False)
        except OSError:  # not every file system knows links
            os.replace(folder / name, _aside(journal, name))
    if old:
        sync(journal)


def _mend(folder: Path) -> None:
    """What was there before, if a journal says that something else was about to be."""
    journal = folder / JOURNAL
    try:
        about = _read_list(journal / _LIST)
    except (FileNotFoundError, NotADirectoryError, ValueError):
        # Nothing had been moved yet, or all of it; or the journal is none of ours.
        shutil.rmtree(journal, ignore_errors=True)
        return
    stage = folder / about["stage"]
    kept = [name for name in about["old"] if os.path.lexists(_aside(journal, name))]
    for name in about["fresh"]:
        untouched = name in about["old"] and name not in kept
        if not untouched and not os.path.lexists(stage / name):
            _move_back(folder / name, stage / name)
    for name in kept:
        os.replace(_aside(journal, name), folder / name)
    sync(folder)
    os.unlink(journal / _LIST)
    sync(journal)
    shutil.rmtree(journal, ignore_errors=True)


def _read_list(path: Path) -> dict[str, Any]:
    """The journal's list: names in this folder, so that no folder from elsewhere moves others.

    Raises:
        ValueError: it says anything else.
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
    """Undo the move of a new file; without its stage there is no use for it."""
    with suppress(FileNotFoundError):
        if staged.parent.is_dir():
            os.replace(file, staged)
        else:
            os.unlink(file)


def _aside(journal: Path, name: str) -> Path:
    """Where an old file is kept; the suffix keeps it apart from the list."""
    return journal / f"{name}.old"


def _stands(path: Path) -> bool:
    """Whether a file has this name."""
    if path.is_dir() and not path.is_symlink():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    return os.path.lexists(path)


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keep other processes from publishing into the folder meanwhile."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
