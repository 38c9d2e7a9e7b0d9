"""Outputs: files that appear in their folder together, or not at all.

Files are written to a hidden folder in their destination, synced, and renamed into place. If a step
fails or is interrupted, the old files are put back. Existing files are replaced only where the
caller says so (check_output), and never those that the same command reads.
"""

from __future__ import annotations

import errno
import math
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile

from matcap.errors import MatcapError, UsageError
from matcap.files.names import StagedFolder

HIDDEN = ".matcap-"  # prefix of the names of hidden folders
_ELSEWHERE = "choose another folder with {option}"
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


@dataclass(frozen=True)
class Output:
    """The files of one run in a folder."""

    folder: Path
    """Destination; created if missing."""
    replacing: Sequence[str] = ()
    """Names of older files in it that go when the new ones appear."""

    @contextmanager
    def stage(self, name: str = "") -> Iterator[StagedFolder]:
        """Context of a hidden folder, whose files are moved to `folder` on exit.

        After an exception nothing has changed, and created folders are removed.

        Args:
            name: of the hidden folder, which then is the caller's to publish and to remove.

        Raises:
            MatcapError: the disk is full, the folder cannot be written, a folder has a file's name,
                and the like.
        """
        try:
            with _made(self.folder):
                if name:
                    (self.folder / name).mkdir(exist_ok=True)
                    yield StagedFolder(self.folder / name)
                    return
                with TemporaryDirectory(
                    prefix=HIDDEN, dir=self.folder, ignore_cleanup_errors=True
                ) as made:
                    yield StagedFolder(made)
                    self.publish(Path(made), os.listdir(made))
        except OSError as error:
            raise write_error(_culprit(self.folder, error), error) from error

    @staticmethod
    @contextmanager
    def file(path: Path) -> Iterator[Path]:
        """Context of a temporary path, whose file is moved to `path` on exit; see stage()."""
        with Output(path.parent).stage() as stage:
            yield stage / path.name

    def publish(self, stage: Path, names: Iterable[str]) -> None:
        """Move files from their stage to the folder, JSON documents last, all or none.

        Raises:
            OSError: with the name of the file; nothing has changed then.
        """
        fresh = sorted(set(names), key=lambda name: (name.endswith(".json"), name))
        every = dict.fromkeys([*fresh, *self.replacing])
        old = [name for name in every if _file_exists(self.folder / name)]
        if not self.folder.name.startswith(HIDDEN):  # else itself a stage
            for name in fresh:
                sync(stage / name)
        if len({*fresh, *old}) == 1 and fresh:  # the rename alone is atomic
            os.replace(stage / fresh[0], self.folder / fresh[0])
            return
        moved: list[tuple[Path, Path]] = []
        with TemporaryDirectory(prefix=HIDDEN, dir=self.folder) as aside:
            moves = [(self.folder / name, Path(aside) / name) for name in old]
            moves += [(stage / name, self.folder / name) for name in fresh]
            try:
                for start, end in moves:
                    moved.append((start, end))
                    os.replace(start, end)
            except BaseException:
                for start, end in reversed(moved):
                    with suppress(FileNotFoundError):  # the step that failed
                        os.replace(end, start)
                raise


def check_output(
    paths: Iterable[Path],
    *,
    inputs: Iterable[Path] = (),
    overwrite: bool = False,
    option: str = "-o",
) -> None:
    """Refuse outputs that exist, or that would replace an input.

    Args:
        inputs: files that the call reads, and folders of such files.
        overwrite: replace what exists.
        option: names the outputs, for the advice.

    Raises:
        UsageError: an output is an input.
        MatcapError: an output exists, and `overwrite` was not given; or it is a folder.
    """
    read = {
        file.resolve()
        for given in inputs
        for file in (given.iterdir() if given.is_dir() else (given,))
    }
    for path in paths:
        if path.resolve() in read:
            raise UsageError.at(path, "the same command reads this file", "choose another name")
        if path.is_dir():
            raise MatcapError.at(path, "this is a folder", f"choose another name with {option}")
        if path.exists() and not overwrite:
            remedy = f"choose another name with {option}, or give --overwrite"
            raise MatcapError.at(path, "this exists already", remedy)


def check_writable(folder: Path, space: int, names: Iterable[str] = (), option: str = "-o") -> None:
    """Check that files can be written before work begins; leaves nothing behind.

    Args:
        folder: destination, which need not exist.
        space: bytes that the files take.
        names: of the files, if known.
        option: names the folder, for the advice.

    Raises:
        MatcapError: the folder cannot be created or written, a folder has a file's name, or the
            disk has too little space.
    """
    try:
        with _made(folder), TemporaryFile(prefix=HIDDEN, dir=folder):
            free = shutil.disk_usage(folder).free
            for name in names:
                _file_exists(folder / name)
    except OSError as error:
        raise write_error(_culprit(folder, error), error, option) from error
    if free < space:
        raise MatcapError.at(
            folder,
            f"about {_size(space)} are needed but the disk has {_size(free)} left",
            f"free some space or {_ELSEWHERE}".format(option=option),
        )


def write_error(path: Path, error: OSError, option: str = "-o") -> MatcapError:
    """The error for a failure to write at `path`, which `option` names."""
    reason = error.strerror or str(error) or type(error).__name__
    what, remedy = _REASONS.get(error.errno or 0, (f"could not be written ({reason})", _ELSEWHERE))
    return MatcapError.at(path, what, remedy.format(option=option))


def sync(path: Path) -> None:
    """Flush a file's content, or a folder's entries, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _culprit(folder: Path, error: OSError) -> Path:
    """Path that an error concerns: a file of the folder if it names one, else the folder."""
    for name in (error.filename2, error.filename):
        if isinstance(name, str | os.PathLike) and Path(name).parent == folder:
            return folder if Path(name).name.startswith(".") else Path(name)
    return folder


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Context that creates a missing folder, and removes it on exit if it is still empty."""
    missing = []
    with suppress(OSError):  # creating it will raise the error
        missing = [one for one in (folder, *folder.parents) if not one.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        for one in missing:
            with suppress(OSError):
                one.rmdir()


def _file_exists(path: Path) -> bool:
    """Whether a file exists; raises IsADirectoryError for a folder."""
    if path.is_dir() and not path.is_symlink():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    return os.path.lexists(path)


def _size(count: int) -> str:
    """A number of bytes with its unit."""
    power = min(int(math.log10(max(count, 1)) / 3), 5)
    return f"{count / 1000**power:.3g} {('bytes', 'kB', 'MB', 'GB', 'TB', 'PB')[power]}"
