"""Names of files and UDIM tiles, JSON documents, digests, notes and progress."""

from __future__ import annotations

import hashlib
import json
import re
import unicodedata
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PosixPath
from typing import Any

from matcap.errors import MatcapError, UsageError

# Validation of file names from untrusted files, and numbered series of names.
#
# A name is validated where it is read (plain_name), or turned into a valid one (sanitised_name),
# and checked again when a file is written (StagedFolder).

LONGEST = 200  # bytes, which leaves room for suffixes
_HIDES = {"Cc", "Cf", "Cs", "Zl", "Zp"}  # Unicode categories of invisible characters
_SEPARATORS = "/\\"
_UNUSUAL = re.compile(r"[^\w .,()+-]+")

_NUMBERED = re.compile(r"(.*[^\W\d_].*?)[_\- .]+(\d{1,2})")
_LONGEST_SERIES = 24  # names; longer ones are a camera's counter


def series(stems: Sequence[str]) -> list[list[int]]:
    """Find numbered series among names: oak_1, oak_2, oak_3.

    A series counts from 0 or 1 without a gap, in at most two digits after a separator. A camera's
    counter (IMG_0412) is not a series.

    Args:
        stems: file names without suffixes.

    Returns:
        For each series the indices of its names, in order of their numbers.
    """
    numbered: dict[str, dict[int, int]] = {}
    twice = set()
    for position, stem in enumerate(stems):
        match = _NUMBERED.fullmatch(stem)
        if match is None:
            continue
        name, number = match[1].casefold(), int(match[2])
        if number in numbered.setdefault(name, {}):
            twice.add(name)
        numbered[name][number] = position
    return [
        [at[number] for number in sorted(at)]
        for name, at in numbered.items()
        if name not in twice
        and 2 <= len(at) <= _LONGEST_SERIES
        and min(at) <= 1
        and max(at) - min(at) == len(at) - 1
    ]


def are_a_series(stems: Sequence[str]) -> bool:
    """Whether all names are one numbered series."""
    return any(len(each) == len(stems) for each in series(stems))


def name_fault(name: object) -> str:
    """Why a name is not a plain file name, as the end of a sentence; "" if it is."""
    if not isinstance(name, str):
        return "is no text"
    if not name.strip():
        return "is empty"
    if any(mark in name for mark in _SEPARATORS):
        return "leads to another folder"
    if name.startswith("."):
        return "begins with a dot"
    if any(unicodedata.category(letter) in _HIDES for letter in name):
        return "has characters that do not print"
    return f"is longer than {LONGEST} bytes" if len(name.encode()) > LONGEST else ""


def plain_name(name: str, *, what: str = "the name") -> str:
    """Return the name if it is a plain file name, which cannot lead out of a folder.

    Args:
        what: that the error calls it.

    Raises:
        UsageError: it is not a plain file name.
    """
    wrong = name_fault(name)
    if wrong:
        says = f"{what} {shown(name)} is not a plain file name: it {wrong}"
        raise UsageError(says, remedy="choose another")
    return name


def check_suffix(path: Path, suffixes: Sequence[str], what: str) -> None:
    """Raise UsageError unless an output, a "picture" or the like, has one of the suffixes."""
    if path.suffix.lower() not in suffixes:
        usable = " or ".join(filter(None, (", ".join(suffixes[:-1]), suffixes[-1])))
        raise UsageError.at(path, f"unknown {what} format '{path.suffix}'", f"use {usable}")


def sanitised_name(name: str, otherwise: str = "material") -> str:
    """Turn any text into a plain file name."""
    return _UNUSUAL.sub("_", name)[:100].strip(" .") or otherwise


def usable_name(name: str, otherwise: str = "material") -> str:
    """The name of an existing file if it is plain, else sanitised_name of it."""
    return sanitised_name(name, otherwise) if name_fault(name) else name


def shown(value: object) -> str:
    """A value from a file as a message may quote it: one line of at most 60 characters."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


class StagedFolder(PosixPath):
    """A folder that is written to: `folder / name` is inside it, whatever the name."""

    def __truediv__(self, name: str | Path) -> StagedFolder:  # type: ignore[override]
        """The path of a file in the folder.

        Raises:
            MatcapError: the name would lead out of the folder.
        """
        text = str(name)
        if text in ("", ".", "..") or any(mark in text for mark in (*_SEPARATORS, "\0")):
            raise MatcapError(
                f"{shown(text)} leads out of the folder that is being written",
                remedy="give the files another name",
            )
        return super().__truediv__(text)


# UDIM texture sets: tiles numbered 1001 + column + 10 row from the bottom left.

_COLUMNS, _ROWS = 10, 900


def tile_number(column: int, row: int) -> int:
    """Number of a tile; (0, 0) is the bottom left one, 1001."""
    return 1001 + column + 10 * row


def check_grid(columns: int, rows: int, where: str = "") -> None:
    """Raise UsageError for a texture set of too many tiles, or none; it names `where`."""
    if not (1 <= columns <= _COLUMNS and 1 <= rows <= _ROWS):
        raise UsageError.at(
            where,
            f"a texture set cannot have {columns}x{rows} tiles",
            f"ask for at most {_COLUMNS} columns and {_ROWS} rows",
        )


# Reads JSON documents, which may be missing, damaged or another program's.


def read_document(file: Path, form: str = "") -> dict[str, Any] | None:
    """The JSON object of a file; None if it cannot be read, or its `format` is not `form`."""
    try:
        document = json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    known = isinstance(document, dict) and form in ("", document.get("format"))
    return document if known else None


# Digest check of safetensors files, without PyTorch.
#
# Read next: tensors.py, which writes the digest.

DIGEST, METHOD = "digest", "sha256"  # name of the metadata's entry, and the hash function
_AT_ONCE = 1 << 18  # bytes read at once, which fit a processor's caches


def digest_prefix(metadata: Mapping[str, str]) -> bytes:
    """The metadata's bytes, which the digest covers before the tensors' bytes."""
    entries = sorted((name, text) for name, text in metadata.items() if name != DIGEST)
    return "\0".join(part for entry in entries for part in entry).encode()


def digest_matches(path: Path, metadata: Mapping[str, str]) -> bool:
    """Whether a valid safetensors file has the digest in its metadata; False if there is none.

    Raises:
        OSError: the file cannot be read.
    """
    if DIGEST not in metadata:
        return False
    digest = hashlib.new(METHOD, digest_prefix(metadata))
    with path.open("rb", buffering=0) as file:
        file.seek(int.from_bytes(file.read(8), "little"), 1)
        some = memoryview(bytearray(_AT_ONCE))
        while count := file.readinto(some):
            digest.update(some[:count])
    return digest.hexdigest() == metadata[DIGEST]


# Notes to the user that are not errors, issued as warnings.


class Note(UserWarning):
    """A note to the user, which the command line prints."""


def note(sentence: str) -> None:
    """Issue a note; Python shows the same sentence once a process."""
    warnings.warn(sentence, Note, stacklevel=3)


# The generator mark that every file written by matcap carries.

MAKER_VERSION = "0.1.0"  # of matcap
MAKER = f"matcap {MAKER_VERSION}"

# Progress reports of long-running work, passed to a callback.


@dataclass(frozen=True)
class Progress:
    """Progress of long-running work."""

    stage: str
    """Name of the present stage."""
    fraction: float
    """Share of the work done, in [0, 1]."""
    seconds: float = 0.0
    """Since the start; 0 if not measured."""
    seconds_left: float | None = None
    """Expected remaining time, or None if unknown."""


OnProgress = Callable[[Progress], None]


def ignore_progress(now: Progress) -> None:
    """Callback that does nothing."""
