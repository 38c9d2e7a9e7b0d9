"""The HTML document of the page, served or self-contained with its maps.

The page's scripts are modules. The served document links them as files. The self-contained one has
them concatenated, in the order of SCRIPTS: each imports only from those before it, and no two
define the same name.

The element `about` is JSON; in a self-contained document its entry `tile` is the maps, which
page/tile.js unpacks.

Tile:
    size: (width, height) in texels.
    specular_channels: 1, or 3 where F0 has a colour.
    low: least height, plane units.
    span: greatest height less the least.
    data: base64 of zlib-compressed 16-bit words, all low bytes before all high bytes: planes of
        diffuse (3), specular and roughness as half floats, then height: low + word / 65535 * span.
        Diffuse and specular are rounded to 8 of the 10 fraction bits, so that they compress better.
"""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import asdict
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError, UsageError
from matcap.files.exr import LARGEST_HALF
from matcap.files.names import check_suffix
from matcap.files.output import Output
from matcap.view.subject import (
    APRON,
    MIPS,
    PAGE_HEIGHT,
    WIDTH,
    EncodedPicture,
    Materials,
    Viewable,
    ViewFacts,
)

_SPARED = 2  # fraction bits of half floats that albedos are rounded by


def packed_tile(maps: MapSet) -> dict[str, Any]:
    """The JSON entry of a tile.

    Raises:
        MatcapError: maps of values that half floats cannot hold.
    """
    stacked = maps.stacked().numpy()
    surface, height = stacked[:-1], stacked[-1]
    if np.abs(surface).max() > LARGEST_HALF:
        raise MatcapError(
            "the maps have values too large for half float (65504)", remedy="scale them down"
        )
    low = float(height.min())
    span = float(height.max()) - low or 1.0
    steps = np.rint((height - low) / span * 65535.0).astype("<u2")
    halves = surface.astype("<f2").view("<u2")
    half = np.uint16(1 << _SPARED >> 1)
    halves[:-1] = (halves[:-1] + half) & np.uint16(0xFFFF << _SPARED & 0xFFFF)
    words = np.concatenate([halves.ravel(), steps.ravel()])
    # All low bytes before all high bytes, which compresses better.
    split = words.view(np.uint8).reshape(-1, 2).T
    return {
        "size": list(maps.size),
        "specular_channels": len(maps.specular),
        "low": low,
        "span": span,
        "data": base64.b64encode(zlib.compress(split.tobytes(), 9)).decode(),
    }


SCRIPTS = (
    "surroundings.js", "rooms.js", "pages.js", "shader.js", "tile.js", "source.js", "controls.js",
    "view.js", "panel.js", "gestures.js", "main.js",
)  # fmt: skip
STYLE = "page.css"
DEFAULT_TILE = 512  # texels: some 3 MB
_LARGEST_TILE = 2048  # texels a side of the tile: some 50 MB
# Content security policy of a self-contained document: its own scripts only, no requests.
_SEALED = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)


def page_file(name: str) -> str:
    """The text of one of the page's own files."""
    return (files("matcap.view") / "page" / name).read_text(encoding="utf-8")


def served_page(facts: ViewFacts, photo: EncodedPicture | None) -> str:
    """The document that fetches scripts and pages from its server."""
    head = f'<link rel="stylesheet" href="{STYLE}">'
    scripts = f'<script type="module" src="{SCRIPTS[-1]}"></script>'
    about = _about(facts) | {"photo": photo and "photo"}
    return _document(facts.name, head, scripts, about)


def sealed_page(
    subject: Viewable, size: int = DEFAULT_TILE, photo: EncodedPicture | None = None
) -> str:
    """The self-contained document, with a seamless tile of the subject.

    Args:
        subject: a material, whose field is made periodic, or a map set as it is.
        size: sides of a material's tile in texels, a multiple of 16.
        photo: the photograph.

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
    about = _about(facts) | {
        "photo": photo and photo.url,
        "second": "",
        "period": list(maps.size),
        "tile": packed_tile(maps),
    }
    return _document(facts.name, head, scripts, about)


def write_page(document: str, path: Path) -> None:
    """Write a document atomically.

    Raises:
        UsageError: the name does not end in .html.
        MatcapError: the file cannot be written.
    """
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
    if max(subject.maps.size) > _LARGEST_TILE:
        raise UsageError.at(
            subject.name,
            f"a map set of {subject.maps.size[0]}x{subject.maps.size[1]} is too large for one page",
            f"make one of at most {_LARGEST_TILE} texels a side",
        )
    return subject.maps


def _about(facts: ViewFacts) -> dict[str, Any]:
    """The element `about`, of a served document without a photograph."""
    form = {"width": WIDTH, "height": PAGE_HEIGHT, "apron": APRON, "mips": MIPS}
    return asdict(facts) | {"page": form, "photo": None, "tile": None}


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
