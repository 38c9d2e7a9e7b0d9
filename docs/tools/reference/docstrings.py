"""Docstrings in Google's style, taken apart and written as Markdown.

A section is a line that ends with a colon, followed by indented lines `name: what it is`. Beside
Args, Attributes, Returns and Raises any heading may stand there: modules that own a file's format
list its keys so.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

_HEADING = re.compile(r"([A-Z][\w ]*):")
_ENTRY = re.compile(r"([^\s:][^:]*): (.*)|([^\s:][^:]*):$")


@dataclass(frozen=True)
class Docstring:
    """What a docstring says."""

    text: str
    """Markdown outside of any section."""
    sections: Mapping[str, str]
    """By heading, the lines of each without their indentation."""

    def entries(self, heading: str) -> dict[str, str]:
        """What a section says of each name; none where there is no such section.

        Names that share a line, such as `x, y: where`, are told apart.
        """
        found: dict[str, str] = {}
        names: list[str] = []
        for line in self.sections.get(heading, "").splitlines():
            entry = None if line.startswith(" ") else _ENTRY.match(line)
            if entry:
                names = (entry[1] or entry[3]).split(", ")
                found |= dict.fromkeys(names, entry[2] or "")
            else:
                found |= {name: f"{found[name]} {line.strip()}".strip() for name in names}
        return found


def read(thing: object) -> Docstring:
    """The docstring of a module, a class or a function."""
    text: list[str] = []
    sections: dict[str, list[str]] = {}
    into = text
    for line in inspect.cleandoc(getattr(thing, "__doc__", None) or "").splitlines():
        heading = _HEADING.fullmatch(line)
        if heading:
            into = sections.setdefault(heading[1], [])
        elif line and not line.startswith(" ") and into is not text:
            into = text
            into += ["", line]
        else:
            into.append(line)
    cut = {name: inspect.cleandoc("\n" + "\n".join(lines)) for name, lines in sections.items()}
    whole = re.sub(r"\n{3,}", "\n\n", "\n".join(text).strip())
    return Docstring(_markdown(whole), cut)


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A table's lines, a blank one at its end."""
    lines = [f"| {' | '.join(heads)} |", f"| {' | '.join('---' for _ in heads)} |"]
    lines += [f"| {' | '.join(map(cell, row))} |" for row in rows]
    return [*lines, ""]


def cell(text: str) -> str:
    """Text that does not end a cell."""
    return re.sub(r"\s+", " ", _markdown(text)).replace("|", "\\|").strip()


def _markdown(text: str) -> str:
    """Doubled backticks, as docstrings have them, are single ones in Markdown."""
    return text.replace("``", "`")
