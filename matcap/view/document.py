"""Composes the HTML document of the page, served or self-contained.

The page's scripts are modules. The served document links them as files. The self-contained one has
them concatenated, in the order of SCRIPTS: each imports only from those before it, and no two
define the same name.

The element `about` is JSON; in a self-contained document its entries `tile` and `enclosed` are the
maps (enclosed.py).
"""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matcap.brdf.adjust import NONE, Adjustments
from matcap.errors import UsageError
from matcap.example.example import Example
from matcap.files.names import check_suffix
from matcap.view.enclosed import packed_piece, packed_tile
from matcap.view.pages import APRON, MIPS, PAGE_HEIGHT, WIDTH
from matcap.view.references import References
from matcap.view.subject import Maps, Materials, Viewable, ViewFacts

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet

SCRIPTS = (
    "adjust.js", "address.js", "surroundings.js", "rooms.js", "pages.js", "shader.js", "tile.js",
    "source.js", "controls.js", "theme.js", "view.js", "panel.js", "gestures.js", "reading.js",
    "bring.js", "main.js",
)  # fmt: skip
STYLE = "page.css"
DEFAULT_TILE = 512  # texels: some 3 MB
_PIECE_SIDES = (512, 256)  # texels along the exemplar's longer side: the first that fits is used
_LONGEST = 4_000_000  # bytes of a self-contained document with a tile of at most the default size
_LARGEST_TILE = 2048  # texels a side of the tile: some 50 MB
# Content security policy of a self-contained document: its own scripts only, no requests.
_SEALED = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)


def page_file(name: str) -> str:
    """The text of one of the page's own files."""
    return (files("matcap.view") / "page" / name).read_text(encoding="utf-8")


def served_page(facts: ViewFacts, references: References, adjust: Adjustments = NONE) -> str:
    """The document that fetches scripts and pages from its server."""
    head = f'<link rel="stylesheet" href="{STYLE}">'
    scripts = f'<script type="module" src="{SCRIPTS[-1]}"></script>'
    about = _about(facts, adjust, references) | {
        "photo": references.photo and "photo",
        "doubt": references.doubt and "doubt",
    }
    return _document(facts.name, head, scripts, about)


def sealed_page(
    subject: Viewable,
    size: int = DEFAULT_TILE,
    references: References | None = None,
    adjust: Adjustments = NONE,
) -> str:
    """The self-contained document, with a seamless tile of the subject.

    Args:
        subject: a material, whose field is made periodic, or a map set as it is.
        size: sides of a material's tile in texels, a multiple of 16.
        references: photograph, doubt mask and verdict.
        adjust: initial adjustments.

    Raises:
        UsageError: a size out of range or not a multiple of 16; a map set that is too large.
        MatcapError: maps of values that half floats cannot hold.
    """
    maps = _tile(subject, size)
    facts = subject.facts
    head = (
        f'<meta http-equiv="Content-Security-Policy" content="{_SEALED}">'
        f"<style>\n{page_file(STYLE)}</style>"
    )
    joined = "\n".join(page_file(name) for name in SCRIPTS)  # without imports and exports
    exports = r"^export |^import \{[^}]*\}\s+from [^;]*;\n"
    joined = re.sub(exports, "", joined, flags=re.MULTILINE)
    scripts = f'<script type="module">\n{joined}</script>'
    references = references or References()
    about = _about(facts, adjust, references) | {
        "photo": references.photo and references.photo.url,
        "doubt": references.doubt and references.doubt.url,
        "second": "",
        "period": list(maps.size),
        "tile": packed_tile(maps),
    }
    text = _document(facts.name, head, scripts, about)
    example = subject.first.part(Example) if isinstance(subject, Materials) else None
    if example is None:
        return text
    for side in _PIECE_SIDES:
        piece = packed_piece(example.exemplar, side)
        enclosed = about | {"enclosed": piece, "piece_level": piece["level"]}
        text = _document(facts.name, head, scripts, enclosed)
        if len(text) <= _LONGEST or size > DEFAULT_TILE:
            break
    return text


def write_page(document: str, path: Path) -> None:
    """Write a document atomically.

    Raises:
        UsageError: the name does not end in .html.
        MatcapError: the file cannot be written.
    """
    from matcap.files.output import Output

    check_page_path(path)
    with Output.file(path) as file:
        file.write_text(document, encoding="utf-8")


def check_page_path(path: Path) -> None:
    """Raise UsageError unless a page can have the path's suffix."""
    check_suffix(path, (".html", ".htm"), "page")


def _tile(subject: Viewable, size: int) -> MapSet:
    if isinstance(subject, Materials):
        if not 16 <= size <= _LARGEST_TILE or size % 16:
            raise UsageError.at(
                "--tile",
                f"a tile of {size} texels is not possible",
                f"choose a multiple of 16 from 16 to {_LARGEST_TILE}",
            )
        return subject.first.maps(size, size, seed=subject.seed, period=(size, size))
    assert isinstance(subject, Maps)
    if max(subject.maps.size) > _LARGEST_TILE:
        raise UsageError.at(
            subject.name,
            f"a map set of {subject.maps.size[0]}x{subject.maps.size[1]} is too large for one page",
            f"make one of at most {_LARGEST_TILE} texels a side",
        )
    return subject.maps


def _about(facts: ViewFacts, adjust: Adjustments, references: References) -> dict[str, Any]:
    """The element `about`, of a served document without pictures."""
    form = {"width": WIDTH, "height": PAGE_HEIGHT, "apron": APRON, "mips": MIPS}
    return asdict(facts) | {
        "page": form,
        "adjust": adjust.text,
        "verdict": references.verdict,
        **dict.fromkeys(("photo", "doubt", "tile", "enclosed")),
        "piece_level": 0,
    }


def _document(title: str, head: str, scripts: str, about: dict[str, Any]) -> str:
    # Only '<' could end the script element.
    data = json.dumps(about, allow_nan=False).replace("<", "\\u003c")
    parts = {"title": escape(title), "head": head, "about": data, "scripts": scripts}
    text = page_file("page.html")
    for name, value in parts.items():
        before, mark, after = text.partition("{{" + name + "}}")
        assert mark, name
        text = before + value + after
    return text
