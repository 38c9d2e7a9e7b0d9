"""Validation of file names that come from files.

A name is checked where it comes in (`plain_name`, or `made_plain` where it is only called after
something) and a second time at the moment of writing (`StagedFolder`).
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path, PosixPath

from matcap.errors import MatcapError, UsageError

LONGEST = 200  # bytes, so that there is room for what is written after a name
_HIDES = {"Cc", "Cf", "Cs", "Zl", "Zp"}  # Unicode's kinds of what does not print, or hides
_SEPARATORS = "/\\"
_UNUSUAL = re.compile(r"[^\w .,()+-]+")


_NUMBERED = re.compile(r"(.*[^\W\d_].*?)[_\- .]+(\d{1,2})")
_LONGEST_SERIES = 24  # names; more are a camera's count


def series(stems: Sequence[str]) -> list[list[int]]:
    """Which names are numbered parts of one thing: oak_1, oak_2, oak_3.

    A series counts from 0 or 1 without a gap, with a mark before numbers of at most two digits:
    what cameras count (IMG_0412) is none.

    Args:
        stems: names of files without their endings.

    Returns:
        Positions of the names of each series, in the order of their numbers.
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
    """Whether all names are numbered parts of one thing."""
    return any(len(each) == len(stems) for each in series(stems))


def flaw(name: object) -> str:
    """What keeps a name from being a plain file name, as the end of a sentence; "" for nothing."""
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
    """The name itself when it is a plain file name, so that nothing leaves its folder.

    Args:
        name: to be checked, of any type.
        what: it is the name of, for the sentence.
        where: it stands: a file or an option.

    Raises:
        UsageError: it is none.
    """
    wrong = flaw(name)
    if wrong:
        raise UsageError(
            f"{what} {shown(name)} is not a plain file name: it {wrong}",
            where=where,
            remedy="choose another",
        )
    return name


def made_plain(name: str, otherwise: str = "material") -> str:
    """A plain file name after any text: what a stranger's material is called."""
    return _UNUSUAL.sub("_", name)[:100].strip(" .") or otherwise


def is_usual(name: str) -> bool:
    """Whether every program reads it as it stands: letters, digits, and _ . , ( ) + - and space."""
    return not _UNUSUAL.search(name)


def kept_plain(name: str, otherwise: str = "material") -> str:
    """A name that stands on a disk already: itself where it is plain, else one after it."""
    return made_plain(name, otherwise) if flaw(name) else name


def shown(value: object) -> str:
    """A value from a file as a message may quote it: one line, not long."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


class StagedFolder(PosixPath):
    """A folder that is being filled: what `folder / name` gives lies in it, whatever the name."""

    def __truediv__(self, name: str | Path) -> StagedFolder:  # type: ignore[override]
        """The path of a file in it.

        Raises:
            MatcapError: the name leads elsewhere.
        """
        text = str(name)
        if text in ("", ".", "..") or any(mark in text for mark in (*_SEPARATORS, "\0")):
            raise MatcapError(
                f"{shown(text)} leads out of the folder that is being written",
                remedy="give the files another name",
            )
        return super().__truediv__(text)
