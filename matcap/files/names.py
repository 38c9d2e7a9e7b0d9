"""Validation of file names from untrusted files, and numbered series of names.

A name is validated where it is read (plain_name), or turned into a valid one (sanitised_name), and
checked again when a file is written (StagedFolder).
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path, PosixPath

from matcap.errors import MatcapError, UsageError

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


def plain_name(name: str, *, what: str = "the name", where: str = "") -> str:
    """Return the name if it is a plain file name, which cannot lead out of a folder.

    Args:
        what: that the error calls it.
        where: file or option that the error names.

    Raises:
        UsageError: it is not a plain file name.
    """
    wrong = name_fault(name)
    if wrong:
        raise UsageError.at(
            where, f"{what} {shown(name)} is not a plain file name: it {wrong}", "choose another"
        )
    return name


def check_suffix(path: Path, suffixes: Sequence[str], what: str) -> None:
    """Raise UsageError unless an output, a "picture" or the like, has one of the suffixes."""
    if path.suffix.lower() not in suffixes:
        usable = " or ".join(filter(None, (", ".join(suffixes[:-1]), suffixes[-1])))
        raise UsageError.at(path, f"unknown {what} format '{path.suffix}'", f"use {usable}")


def sanitised_name(name: str, otherwise: str = "material") -> str:
    """Turn any text into a plain file name."""
    return _UNUSUAL.sub("_", name)[:100].strip(" .") or otherwise


def is_portable(name: str) -> bool:
    """Whether a name has only letters, digits, spaces and _ . , ( ) + -, safe for all programs."""
    return not _UNUSUAL.search(name)


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
