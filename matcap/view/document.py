"""The HTML document of the page, served or self-contained with its maps.

The page's scripts are modules. The served document links them as files. The self-contained one has
them concatenated, in the order of SCRIPTS: each imports only from those before it, and no two
define the same name.

The element `about` is JSON; in a self-contained document its entries `tile` and `enclosed` are the
maps below.

Maps inside a self-contained document, which page/tile.js unpacks.

The document's element `about` is JSON; its entry `tile` is a tile's maps, and its entry `enclosed`
the exemplar, or null. Entries called `data` are base64 of zlib-compressed bytes.

Tile:
    size: (width, height) in texels.
    specular_channels: 1, or 3 where F0 has a colour.
    low: least height, plane units.
    span: greatest height less the least.
    data: 16-bit words, all low bytes before all high bytes: planes of diffuse (3), specular and
        roughness as half floats, then height: low + word / 65535 * span. Diffuse and specular are
        rounded to 8 of the 10 fraction bits, so that they compress better.

Exemplar:
    size: (width, height) in texels of the level.
    level: texels are 2^level texels of the material wide.
    diffuse: a JPEG as a data URL.
    specular_channels: 1, or 3 where F0 has a colour.
    low: least value of each specular channel, of roughness and of height. Roughness includes the
        variance of normals within a texel.
    span: greatest value of each less the least.
    data: specular, then roughness, in 255 steps a byte, then low and high bytes of height in 65535
        steps; each number is the difference from the one before.
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
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.adjust import NONE, Adjustments
from matcap.errors import MatcapError, UsageError
from matcap.example.example import Example
from matcap.files.exr import LARGEST_HALF
from matcap.files.names import check_suffix
from matcap.files.pixels import jpeg_bytes
from matcap.view.level_of_detail import (
    ALPHA2,  # fmt: skip
    DIFFUSE,  # fmt: skip
    F0,  # fmt: skip
    HEIGHT,  # fmt: skip
    SQUARES,  # fmt: skip
    Planes,  # fmt: skip
    edged,  # fmt: skip
    halved,  # fmt: skip
    moments_of,  # fmt: skip
)
from matcap.view.pages import APRON, MIPS, PAGE_HEIGHT, WIDTH, EncodedPicture, References
from matcap.view.subject import Maps, Materials, Viewable, ViewFacts

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet
    from matcap.example.exemplar import Exemplar


_QUALITY = 90  # of the exemplar's JPEG
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
    low, span = _ends(height)
    steps = np.rint((height - low) / span * 65535.0).astype("<u2")
    halves = surface.astype("<f2").view("<u2")
    halves[:-1] = _shortened(halves[:-1])
    words = np.concatenate([halves.ravel(), steps.ravel()])
    # All low bytes before all high bytes, which compresses better.
    split = words.view(np.uint8).reshape(-1, 2).T
    return {
        "size": list(maps.size),
        "specular_channels": len(maps.specular),
        "low": low,
        "span": span,
        "data": _text(split),
    }


def packed_piece(exemplar: Exemplar, side: int) -> dict[str, Any]:
    """The JSON entry of an exemplar, of at most `side` texels along its longer side."""
    level, moments = 0, moments_of(edged(exemplar.stacked()), exemplar.texel_size)
    while max(moments.shape[1:]) > side:
        height, width = moments.shape[1:]
        moments = halved(moments[:, : height & ~1, : width & ~1])
        level += 1
    rough = _roughness(moments, exemplar.texel_size * 2**level)
    parts, ends = [], []
    planes = [*((plane, 255) for plane in (*moments[F0], rough)), (moments[HEIGHT], 65535)]
    for plane, steps in planes:
        low, span = _ends(plane)
        ends.append((low, span))
        words = np.rint((plane - low) / span * steps).astype("<u1" if steps == 255 else "<u2")
        words = np.diff(words.ravel(), prepend=words.dtype.type(0))
        parts.append(words.view(np.uint8).reshape(words.size, -1).T.ravel())
    diffuse = jpeg_bytes(moments[DIFFUSE].transpose(1, 2, 0), _QUALITY, subsampling=0)
    return {
        "size": [moments.shape[2], moments.shape[1]],
        "level": level,
        "specular_channels": len(moments[F0]),
        "diffuse": EncodedPicture(diffuse, "image/jpeg").url,
        "low": [low for low, _ in ends],
        "span": [span for _, span in ends],
        "data": _text(np.concatenate(parts)),
    }


def _roughness(moments: Planes, texel_size: float) -> NDArray[np.float32]:
    """(H, W) perceptual roughness, including slope variance that the heights do not show."""
    stacked = np.zeros((6, *moments.shape[1:]), np.float32)
    stacked[5] = moments[HEIGHT]
    left = np.maximum(moments[SQUARES] - moments_of(edged(stacked), texel_size)[SQUARES], 0.0)
    return np.sqrt(np.sqrt(np.minimum(moments[ALPHA2] + left, 1.0)))


def _shortened(halves: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Half floats, as their bits, rounded to _SPARED bits fewer."""
    half = np.uint16(1 << _SPARED >> 1)
    return (halves + half) & np.uint16(0xFFFF << _SPARED & 0xFFFF)


def _ends(plane: NDArray[np.float32]) -> tuple[float, float]:
    low, high = float(plane.min()), float(plane.max())
    return low, high - low or 1.0


def _text(data: NDArray[np.uint8]) -> str:
    return base64.b64encode(zlib.compress(data.tobytes(), 9)).decode()


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
