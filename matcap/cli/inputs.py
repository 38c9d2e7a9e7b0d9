"""The input files of a command, which it must not overwrite."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from matcap.files.mark import mark_of

_READ = (".matcap", ".json", ".exr")  # of a folder: materials, map sets and their pictures


def files_read(*given: Path | None) -> list[Path]:
    """Files among `given`, and possible maps in given folders or next to a map set's JSON file."""
    return [file for path in given if path is not None for file in _of(path)]


def _of(path: Path) -> Iterable[Path]:
    if path.is_dir() or path.suffix.lower() == ".json":
        folder = path if path.is_dir() else path.parent
        files = [file for file in sorted(folder.glob("*")) if file.suffix.lower() in _READ]
        return [file for file in files if not mark_of(file)]  # what relight left is no map
    return [path]
