"""A disk that fails at a chosen step, and one whose power goes: for what promises all or none.

Both stand in for the functions of `os` and `open`, for what lies below one folder. Libraries that
write by themselves are not seen until their files are synced or moved.
"""

from __future__ import annotations

import builtins
import errno
import io
import os
import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

_CALLS = ("replace", "rename", "link", "unlink", "fsync", "mkdir", "rmdir", "open")


@contextmanager
def watched(root: Path, seen: Callable[[str, list[Path]], Path | None]) -> Iterator[None]:
    """While the block runs, tell `seen` of every call on files below root, before it is made.

    Opening to write is two steps, "create" and "write"; `seen` may give another path for it.
    """
    originals = {name: getattr(os, name) for name in _CALLS}
    opened = io.open

    def below(path) -> Path | None:
        path = Path(os.path.abspath(os.fsdecode(path)))
        return path if path.is_relative_to(root) else None

    def by_handle(handle: int) -> str:
        try:
            return os.readlink(f"/proc/self/fd/{handle}")
        except OSError:
            return ""

    def stand_in(name: str):
        def call(*arguments, **named):
            count = 2 if name in ("replace", "rename", "link") else 1
            paths = []
            for path in arguments[:count]:
                if isinstance(path, int):
                    path = by_handle(path)
                elif named.get("dir_fd") is not None:
                    path = os.path.join(by_handle(named["dir_fd"]), os.fsdecode(path))
                paths.append(below(path))
            if all(paths):
                seen(name, paths)
            if name != "fsync":  # which this disk stands in for, and which takes time
                return originals[name](*arguments, **named)

        return call

    def stand_in_open(file, mode="r", *arguments, **named):
        place = None if isinstance(file, int) else below(file)
        if place is not None and set(mode) & set("wax+"):
            seen("create", [place])
            file = seen("write", [place]) or file
        return opened(file, mode, *arguments, **named)

    try:
        for name in _CALLS:
            setattr(os, name, stand_in(name))
        io.open = builtins.open = stand_in_open
        yield
    finally:
        for name, original in originals.items():
            setattr(os, name, original)
        io.open = builtins.open = opened


@dataclass
class Failing:
    """Fails at one step, or from it on."""

    at: int = -1
    """Step that fails; none by default, to count them."""
    lasting: bool = False
    """Whether all later steps fail too, until the block ends."""
    error: BaseException | None = None
    """Error to raise; that of a full disk by default."""
    steps: int = 0
    """Number of steps so far."""

    def seen(self, name: str, paths: list[Path]) -> Path | None:
        now, self.steps = self.steps, self.steps + 1
        if now != self.at and not (self.lasting and now > self.at >= 0):
            return None
        if name == "write":
            return Path("/dev/full")
        raise self.error or OSError(errno.EIO, os.strerror(errno.EIO), str(paths[-1]))


def contents(root: Path) -> dict[str, bytes]:
    """Every file that is not hidden, by its path below root."""
    return {
        name: file.read_bytes()
        for file in root.rglob("*")
        if "/." not in f"/{(name := file.relative_to(root).as_posix())}" and file.is_file()
    }


@dataclass(frozen=True)
class Change:
    """Names that come and go at once."""

    folders: frozenset[int]
    """Numbers of the folders that it touches."""
    entries: tuple[tuple[int, str, int | None], ...]
    """(folder, name, number of the file or None)."""


@dataclass
class Recorded:
    """What a run asked of the disk, to be cut off anywhere.

    A file's content is sure to be there once it is synced, a name once its folder is; names of
    one folder reach the disk in their order (as journalling file systems keep it), those of
    several folders in any.
    """

    root: Path
    """The folder that is watched."""
    log: list[Change | int] = field(default_factory=list)  # a change, or what was synced
    _folders: dict[int, dict[str, int]] = field(default_factory=dict)
    _data: dict[int, bytes] = field(default_factory=dict)  # of files, once synced

    def __post_init__(self) -> None:
        self._top = self._take_in(self.root)
        self._before = {number: dict(names) for number, names in self._folders.items()}
        self._old = dict(self._data)

    def seen(self, name: str, paths: list[Path]) -> None:
        """A call is about to be made."""
        if name in ("create", "write", "open"):
            return
        *source, path = paths
        if not path.parent.exists():
            return
        parent, last = self._at(path.parent), path.name
        if name == "fsync":
            number = self._find(path)
            if number not in self._folders:
                self._data[number] = path.read_bytes()
            self.log.append(number)
        elif name == "mkdir":
            if not path.exists():
                number = self._new()
                self._folders[number] = {}
                self._do([(parent, last, number)], number)
        elif source:
            number, old = self._find(source[0]), self._at(source[0].parent)
            if path.is_dir() and any(path.iterdir()):
                return  # will be refused
            here = [(parent, last, number)]
            self._do(here if name == "link" else [(old, source[0].name, None), *here])
        elif last in self._folders[parent]:
            self._do([(parent, last, None)])

    def cuts(self, chance: random.Random, each: int) -> Iterator[tuple[int, frozenset[int]]]:
        """(after which step, changes on the disk): all, the fewest, and some between."""
        had = set()
        for step in range(len(self.log) + 1):
            for share in (1.0, 0.0, *(chance.random() for _ in range(each))):
                cut = (step, frozenset(self._survivors(step, share, chance)))
                if cut not in had:
                    had.add(cut)
                    yield cut

    def restore(self, step: int, survivors: frozenset[int], place: Path) -> None:
        """What is found on the disk after such a cut, below a new folder."""
        folders = {number: dict(names) for number, names in self._before.items()}
        for index in sorted(survivors):
            change = self.log[index]
            for folder, name, what in change.entries:
                names = folders.setdefault(folder, {})
                if what is None:
                    names.pop(name, None)
                else:
                    names[name] = what
        synced = {*self._old, *(one for one in self.log[:step] if isinstance(one, int))}
        self._build(self._top, place, folders, synced)

    def _build(self, number: int, place: Path, folders: dict, synced: set[int]) -> None:
        place.mkdir()
        for name, what in folders.get(number, {}).items():
            if what in self._folders:
                self._build(what, place / name, folders, synced)
            else:
                (place / name).write_bytes(self._data[what] if what in synced else b"")

    def _survivors(self, step: int, share: float, chance: random.Random) -> Iterator[int]:
        sure: set[int] = set()  # changes that a sync has forced, with all that they stand on
        waiting: set[int] = set()
        for index in reversed(range(step)):
            one = self.log[index]
            if isinstance(one, int):
                waiting.add(one)
            elif one.folders & waiting:
                sure.add(index)
                waiting |= one.folders
        lost: set[int] = set()  # folders of which something later is not there
        for index, one in enumerate(self.log[:step]):
            if isinstance(one, int):
                continue
            if index in sure or (not one.folders & lost and chance.random() < share):
                yield index
            else:
                lost |= one.folders

    def _do(self, entries: list[tuple[int, str, int | None]], *more: int) -> None:
        for folder, name, what in entries:
            if what is None:
                self._folders[folder].pop(name, None)
            else:
                self._folders[folder][name] = what
        touched = frozenset({*(folder for folder, _, _ in entries), *more})
        self.log.append(Change(touched, tuple(entries)))

    def _find(self, path: Path) -> int:
        """A file's or folder's number; one that was never seen has just been made."""
        if path == self.root:
            return self._top
        parent = self._at(path.parent)
        if path.name not in self._folders[parent]:
            self._do([(parent, path.name, self._new())])
            self._data.setdefault(self._folders[parent][path.name], b"")
        return self._folders[parent][path.name]

    def _at(self, folder: Path) -> int:
        if not folder.is_relative_to(self.root):
            return -1
        number = self._top
        for name in folder.relative_to(self.root).parts:
            number = self._folders[number][name]
        return number

    def _new(self) -> int:
        return len(self._folders) + len(self._data)

    def _take_in(self, path: Path) -> int:
        number = self._new()
        if path.is_dir():
            self._folders[number] = {}
            for inside in path.iterdir():
                with suppress(FileNotFoundError):
                    self._folders[number][inside.name] = self._take_in(inside)
        else:
            self._data[number] = path.read_bytes()
        return number
