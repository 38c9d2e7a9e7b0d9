"""All files or none: outputs are written in a hidden folder beside their place, then renamed.

Read next: picture.py, tensors.py and brdf/folder.py, which write through here.
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
def staged(folder: Path, *, replacing: Iterable[str] = ()) -> Iterator[Path]:
    """A temporary folder whose files appear in `folder` together, or not at all.

    Files of the same name are replaced. Folders made on the way are removed again on failure.

    Args:
        folder: where the files will stand; made when missing.
        replacing: names of older files in `folder` that go when the new ones come.

    Raises:
        MatcapError: the disk is full, the folder cannot be written, and the like.
    """
    made = _missing(folder)
    stage: Path | None = None
    fresh: set[str] = set()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        stage = Path(tempfile.mkdtemp(prefix=".matcap-", dir=folder))
        yield stage
        # The documents last: whoever sees one finds what it names.
        for file in sorted(stage.iterdir(), key=lambda file: (file.suffix == ".json", file.name)):
            try:
                os.replace(file, folder / file.name)
            except OSError as error:
                raise write_error(folder / file.name, error) from error
            fresh.add(file.name)
        for name in set(replacing) - fresh:
            (folder / name).unlink(missing_ok=True)
        made = []
    except OSError as error:
        raise write_error(folder, error) from error
    finally:
        if stage is not None:
            shutil.rmtree(stage, ignore_errors=True)
        _remove_empty(made)


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


def check_writable(folder: Path, room: int) -> None:
    """Fail now rather than after minutes of work: can `room` bytes be written into `folder`?

    Leaves nothing behind; the folder need not exist.

    Raises:
        MatcapError: the folder cannot be made or written, or its disk has less room.
    """
    made = _missing(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            free = shutil.disk_usage(folder).free
    except OSError as error:
        raise write_error(folder, error) from error
    finally:
        _remove_empty(made)
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


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()


def _size(count: int) -> str:
    """Bytes as people say them."""
    power = min(int(math.log10(max(count, 1)) / 3), 5)
    return f"{count / 1000**power:.3g} {('bytes', 'kB', 'MB', 'GB', 'TB', 'PB')[power]}"
