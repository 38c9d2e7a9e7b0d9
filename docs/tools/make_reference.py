"""Write docs/reference again: `python docs/tools/make_reference.py`.

Nothing in these pages is written by hand: commands, Python, file formats and exit codes come from
the code. tests/docs fails while a page says anything else. What files of others are read is said by
hand, in BY_HAND.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from reference import commands, exit_codes, formats, interface

FOLDER = Path(__file__).parents[1] / "reference"
PAGES: Mapping[str, Callable[[], str]] = {
    "commands.md": commands.page,
    "python.md": interface.page,
    "file-formats.md": formats.page,
    "exit-codes.md": exit_codes.page,
}
BY_HAND = ("inputs.md",)


def written(name: str) -> str:
    """A page as it is to stand in its file."""
    text = PAGES[name]()
    title, _, rest = text.partition("\n")
    note = "<!-- Written by `python docs/tools/make_reference.py`: change the code, not this. -->"
    return f"{title}\n\n{note}\n{rest.rstrip()}\n"


if __name__ == "__main__":
    for name in PAGES:
        (FOLDER / name).write_text(written(name), encoding="utf-8")
