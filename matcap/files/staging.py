"""All files or none: outputs are written in a hidden folder beside their place, then published.

Read next: publish.py, which moves them; picture.py, tensors.py and brdf/folder.py, which write
through here.
"""

from __future__ import annotations

import errno
import math
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

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
    """A temporary folder whose files appear in `folder` together, or not at all.

    A path in it is made by `/`, which refuses names that lead out of it. Files of the same name
    are replaced. When the block has ended, they have reached the disk.
    Folders made on the way are removed again on failure.

    Args:
        folder: where the files will stand; made when missing.
        replacing: names of older files in `folder` that go when the new ones come.

    Raises:
        MatcapError: the disk is full, the folder cannot be written, a folder stands in a file's
            place, and the like.
    """
    try:
        with new_folder(folder), _stage(folder) as stage:
            yield stage
            names = [file.name for file in stage.iterdir()]
            if folder.name.startswith(HIDDEN):  # a stage itself, never visible by half
                for name in names:
                    os.replace(stage / name, folder / name)
            else:
                publish(stage, names, folder, replacing=replacing)
    except OSError as error:
        raise write_error(culprit(folder, error), error) from error


@contextmanager
def _stage(folder: Path) -> Iterator[StagedFolder]:
    stage = StagedFolder(tempfile.mkdtemp(prefix=HIDDEN, dir=folder))
    try:
        yield stage
    finally:
        shutil.rmtree(stage, ignore_errors=True)


@contextmanager
def staged_file(path: Path) -> Iterator[Path]:
    """A temporary path; the file written there appears at `path` whole, or not at all.

    Args:
        path: of the file; its folder is made when missing.

    Raises:
        MatcapError: as of staged().
    """
    with staged(path.parent) as stage:
        yield stage / path.name


def check_writable(folder: Path, room: int, names: Iterable[str] = ()) -> None:
    """Fail now rather than after minutes of work: can `room` bytes be written into `folder`?

    Leaves nothing behind; the folder need not exist.

    Args:
        folder: where files will stand.
        room: that they take, in bytes.
        names: of the files, where they are known.

    Raises:
        MatcapError: the folder cannot be made or written, a folder stands where a file is to be,
            or the disk has less room.
    """
    try:
        with new_folder(folder), tempfile.TemporaryFile(dir=folder):
            free = shutil.disk_usage(folder).free
            refuse_folders(folder, names)
    except OSError as error:
        raise write_error(culprit(folder, error), error) from error
    if free < room:
        raise MatcapError(
            f"about {_size(room)} are needed but the disk has {_size(free)} left",
            where=str(folder),
            remedy=f"free some space or {_ELSEWHERE}",
        )


def write_error(path: Path, error: OSError) -> MatcapError:
    """The sentence for a failure to write at `path`."""
    reason = error.strerror or str(error) or type(error).__name__
    what, remedy = _REASONS.get(error.errno or 0, (f"could not be written ({reason})", _ELSEWHERE))
    return MatcapError(what, where=str(path), remedy=remedy)


def culprit(folder: Path, error: OSError) -> Path:
    """What stood in the way: a file of the folder if the error names one, or the folder."""
    for name in (error.filename2, error.filename):
        if isinstance(name, str | os.PathLike) and Path(name).parent == folder:
            return folder if Path(name).name.startswith(HIDDEN) else Path(name)
    return folder


@contextmanager
def new_folder(folder: Path) -> Iterator[None]:
    """A folder while files are put into it; where it was missing it goes again if none came.

    Raises:
        OSError: it cannot be made.
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
    """The folders that making `folder` would make, innermost first."""
    missing = []
    try:
        while not folder.exists() and folder != folder.parent:
            missing.append(folder)
            folder = folder.parent
    except OSError:
        # Not even to be looked at: making it will say why.
        return []
    return missing


def _size(count: int) -> str:
    """Bytes as people say them."""
    power = min(int(math.log10(max(count, 1)) / 3), 5)
    return f"{count / 1000**power:.3g} {('bytes', 'kB', 'MB', 'GB', 'TB', 'PB')[power]}"
