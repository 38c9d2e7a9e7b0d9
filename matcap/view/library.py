"""A folder of materials, shown as spheres under one light, each with a page of its own.

A material is loaded when its page is opened. A sphere shows a swatch: SIDE x SIDE texels of level
LEVEL, of the exemplar or, without one, of the field.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from matcap.brdf.folder import find_mapsets
from matcap.errors import MatcapError
from matcap.field.options import AS_IT_IS, ReadOptions
from matcap.field.plane import Rectangle
from matcap.view.pages import APRON, Page, packed
from matcap.view.references import References, find_references, read_verdict
from matcap.view.subject import Materials

SIDE, LEVEL = 240, 2
_OPENED = 8  # materials cached, of some 50 MB each


class Library:
    """Materials of a folder, by index."""

    def __init__(self, files: Sequence[Path], read: ReadOptions = AS_IT_IS) -> None:
        self.files, self.adjust = tuple(files), read.adjustments
        self._read = read
        self._kept = lru_cache(_OPENED)(self._open)

    def shelf(self) -> list[dict[str, str]]:
        """Name of each file, rating and sentence of its verdict or "", in their order."""
        return [
            {"name": file.stem, "rating": rating, "sentence": sentence}
            for file in self.files
            for rating, sentence in (read_verdict(file.parent) or ("", ""),)
        ]

    def subject(self, first: int, second: int | None = None) -> Materials:
        """Open a material, or two to compare; the last _OPENED are cached.

        Raises:
            MatcapError: a broken file.
        """
        return self._kept(first, second)

    def references(self, index: int) -> References:
        """Photograph, doubt mask and verdict of a material."""
        file = self.files[index]
        subject = self.subject(index)
        # A photograph that cannot be read is left out.
        try:
            return find_references(file, file.stem, None, subject.first)
        except MatcapError:
            return References(verdict=read_verdict(file.parent))

    def swatch(self, index: int) -> Page:
        """The page of texels that a material's sphere shows.

        Raises:
            MatcapError: a broken file.
        """
        subject = self.subject(index)
        piece = subject.facts.piece
        middle = (0, 0) if piece is None else (piece[0] >> LEVEL + 1, piece[1] >> LEVEL + 1)
        area = Rectangle(middle[0] - SIDE // 2, middle[1] - SIDE // 2, SIDE, SIDE).grown(APRON)
        moments, texel_size = subject.moments(
            LEVEL, area, seed=0, share=0.0, piece=piece is not None
        )
        return packed(moments, texel_size)

    def _open(self, first: int, second: int | None) -> Materials:
        from matcap.field.material import Material

        def load(index: int) -> Material:
            material = Material.load(self.files[index])
            return material.by(self._read.generator).varied(self._read.variety)

        return Materials(load(first), None if second is None else load(second))


def find_library(path: Path) -> list[Path]:
    """Material files of a folder and its subfolders; none if the path is a single material's."""
    if not path.is_dir() or find_mapsets(path):
        return []
    own = sorted(path.glob("*.matcap"))
    if len(own) == 1:
        return []
    return [*own, *sorted(path.glob("*/*.matcap"))]


def numbers(name: str, count: int) -> tuple[int, int | None] | None:
    """Parse "3" or "3+5" to one or two indices below `count`; None if invalid."""
    parts = name.split("+")
    if len(parts) > 2 or not all(part.isascii() and part.isdigit() for part in parts):
        return None
    indices = [int(part) for part in parts if len(part) < 9]
    if len(indices) < len(parts) or max(indices) >= count:
        return None
    return indices[0], indices[1] if len(indices) > 1 else None
