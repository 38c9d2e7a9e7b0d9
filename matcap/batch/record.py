"""The record beside each material: what it was made from, and what files belong to it.

A material is done when its record names the identity that is wanted now and every file it lists is
there with its size. Files are flushed to the disk before they get their names, so a size that is
right is a file that is whole.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matcap.files.publish import sync

FILE = "matcap-batch.json"
FORMAT = "matcap batch record"
VERSION = 1  # of the file
_MOST_BYTES = 20_000_000  # thumbnails included


def write_record(folder: Path, about: Mapping[str, Any]) -> None:
    """Write the record of a folder that is not in its place yet, and flush all its files.

    Args:
        folder: of a material, complete but for this.
        about: JSON; identity and whatever else is worth keeping.

    Raises:
        OSError: a full disk and the like.
    """
    files = {
        file.relative_to(folder).as_posix(): file.stat().st_size
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }
    document = {"format": FORMAT, "version": VERSION, **about, "files": files}
    text = json.dumps(document, indent=1, allow_nan=False)
    (folder / FILE).write_text(text + "\n", encoding="utf-8")
    for file in folder.rglob("*"):
        sync(file)
    sync(folder)


def read_record(folder: Path) -> dict[str, Any] | None:
    """The record of a material's folder; None where there is none that can be read."""
    file = folder / FILE
    try:
        if file.stat().st_size > _MOST_BYTES:
            return None
        document = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        return None
    if document.get("version") != VERSION or not isinstance(document.get("files"), dict):
        return None
    return document


def is_done(folder: Path, identity: str) -> bool:
    """Whether a folder holds all of the material of this identity."""
    record = read_record(folder)
    if record is None or record.get("identity") != identity:
        return False
    return all(_size(folder / name) == size for name, size in record["files"].items())


def _size(file: Path) -> int | None:
    try:
        return file.stat().st_size
    except (OSError, ValueError):  # ValueError: a name with a null character
        return None
