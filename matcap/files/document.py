"""Reads JSON documents, which may be missing, damaged or another program's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def read_document(file: Path, form: str = "") -> dict[str, Any] | None:
    """The JSON object of a file; None if it cannot be read, or its `format` is not `form`."""
    try:
        document = json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    known = isinstance(document, dict) and form in ("", document.get("format"))
    return document if known else None
