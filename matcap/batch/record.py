"""The manifest in each material's folder: the hash of its inputs, and its files with their sizes.

A material is done if its record has the requested identity and all files have their sizes. Files
are synced to disk before they are renamed to their final names, so a right size means a complete
file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matcap.files.document import read_document
from matcap.files.output import sync

FILE = "matcap-batch.json"
FORMAT = "matcap batch record"
VERSION = 1  # of the file
_MOST_BYTES = 20_000_000  # thumbnails included


def write_record(folder: Path, about: Mapping[str, Any]) -> None:
    """Write the record of a staged folder, and sync all its files to disk.

    Args:
        folder: of a material, complete but for the record.
        about: JSON entries, `identity` among them.

    Raises:
        OSError: the folder cannot be written.
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
    """The record of a material's folder; None if there is none, or it cannot be read."""
    file = folder / FILE
    document = read_document(file, FORMAT) if (_size(file) or 0) <= _MOST_BYTES else None
    if document is None or document.get("version") != VERSION:
        return None
    return document if isinstance(document.get("files"), dict) else None


def is_done(folder: Path, identity: str) -> bool:
    """Whether a folder holds the complete material of this identity."""
    record = read_record(folder)
    if record is None or record.get("identity") != identity:
        return False
    return all(_size(folder / name) == size for name, size in record["files"].items())


def _size(file: Path) -> int | None:
    try:
        return file.stat().st_size
    except (OSError, ValueError):  # ValueError: a name with a null character
        return None
