"""Atomic writing of files: into a hidden folder first, then published together.

Read next: publish.py, which moves them; picture.py, tensors.py and brdf/folder.py, which use it.
"""

from __future__ import annotations

import errno
import math
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile

from matcap.errors import MatcapError
from matcap.files.names import StagedFolder
from matcap.files.publish import HIDDEN, publish, refuse_folders, sync

_ELSEWHERE = "choose another folder with -o"
_REASONS: dict[int, tuple[str, str]] = {
    errno.ENOSPC: ("the disk is full", f"free some space or {_ELSEWHERE}"),
    errno.EDQUOT: ("the disk quota is used up", f"free some space or {_ELSEWHERE}"),
    errno.EACCES: ("no permission to write here", f"change the permissions or {_ELSEWHERE}"),
    errno.EPERM: ("no permission to write here", f"change the permissions or {_ELSEWHERE}"),
    errno.EROFS: ("the file system is read-only", _ELSEWHERE),
    errno.EEXIST: ("a file stands where a folder is needed", _ELSEWHERE),
    errno.ENOTDIR: ("a file stands where a folder is needed", _ELSEWHERE),
    errno.EISDIR: ("a folder stands where a file is needed", _ELSEWHERE),
    errno.ENAMETOOLONG: ("the name is too long for the file system", "choose a shorter one"),
}


@contextmanager
def staged(folder: Path, *, replacing: Iterable[str] = ()) -> Iterator[StagedFolder]:
    """Context of a temporary folder, whose files are moved to `folder` together on exit.

    After an exception nothing has changed, and created folders are removed. On exit the files are
    synced to the disk. Existing files of the same names are replaced.

    Args:
        folder: destination; created if missing.
        replacing: names of older files in `folder` to remove.

    Raises:
        MatcapError: the disk is full, the folder cannot be written, a folder has a file's name, and
            the like.
    """
    try:
        with (
            new_folder(folder),
            TemporaryDirectory(prefix=HIDDEN, dir=folder, ignore_cleanup_errors=True) as made,
        ):
            stage = StagedFolder(made)
            yield stage
            names = [file.name for file in stage.iterdir()]
            if folder.name.startswith(HIDDEN):  # itself a staging folder
                for name in names:
                    os.replace(stage / name, folder / name)
            else:
                publish(stage, names, folder, replacing=replacing)
    except OSError as error:
        raise write_error(culprit(folder, error), error) from error


@contextmanager
def staged_file(path: Path) -> Iterator[Path]:
    """Context of a temporary path, whose file is moved to `path` on exit.

    Raises:
        MatcapError: see staged().
    """
    with staged(path.parent) as stage:
        yield stage / path.name


def check_writable(folder: Path, space: int, names: Iterable[str] = ()) -> None:
    """Check that files can be written before work begins; leaves nothing behind.

    Args:
        folder: destination, which need not exist.
        space: bytes that the files take.
        names: of the files, if known.

    Raises:
        MatcapError: the folder cannot be created or written, a folder has a file's name, or the
            disk has too little space.
    """
    try:
        with new_folder(folder), TemporaryFile(dir=folder):
            free = shutil.disk_usage(folder).free
            refuse_folders(folder, names)
    except OSError as error:
        raise write_error(culprit(folder, error), error) from error
    if free < space:
        raise MatcapError.at(
            folder,
            f"about {_size(space)} are needed but the disk has {_size(free)} left",
            f"free some space or {_ELSEWHERE}",
        )


def write_error(path: Path, error: OSError) -> MatcapError:
    """The error for a failure to write at `path`."""
    reason = error.strerror or str(error) or type(error).__name__
    what, remedy = _REASONS.get(error.errno or 0, (f"could not be written ({reason})", _ELSEWHERE))
    return MatcapError.at(path, what, remedy)


def culprit(folder: Path, error: OSError) -> Path:
    """Path that an error concerns: a file of the folder if it names one, else the folder."""
    for name in (error.filename2, error.filename):
        if isinstance(name, str | os.PathLike) and Path(name).parent == folder:
            return folder if Path(name).name.startswith(HIDDEN) else Path(name)
    return folder


@contextmanager
def new_folder(folder: Path) -> Iterator[None]:
    """Context that creates a missing folder, and removes it on exit if it is still empty.

    Raises:
        OSError: the folder cannot be created.
    """
    made = _missing(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path in made:
            sync(path.parent)
        yield
    finally:
        for path in made:
            with suppress(OSError):
                path.rmdir()


def _missing(folder: Path) -> list[Path]:
    """Folders that do not exist yet, from `folder` up."""
    missing = []
    try:
        while not folder.exists() and folder != folder.parent:
            missing.append(folder)
            folder = folder.parent
    except OSError:
        # Creating it will raise the error.
        return []
    return missing


def _size(count: int) -> str:
    """A number of bytes with its unit."""
    power = min(int(math.log10(max(count, 1)) / 3), 5)
    return f"{count / 1000**power:.3g} {('bytes', 'kB', 'MB', 'GB', 'TB', 'PB')[power]}"
