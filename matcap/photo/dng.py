"""Reads DNG tags that LibRaw ignores: lens shading, white balance, JPEG XL compression."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matcap.photo.dng_color import COLOR_TAGS, DngColor, dng_color
from matcap.photo.gainmap import GainMap, parse_opcodes
from matcap.photo.refusals import decoding

if TYPE_CHECKING:
    from tifffile import TiffPage

_CFA, _LINEAR_RAW = 32803, 34892  # photometric interpretations (DNG 1.7)
_JPEG_XL = 52546  # a compression (DNG 1.7)
_MOST_PAGES = 64  # a damaged file may claim any number of them
_ACTIVE_AREA, _OPCODES_ON_MOSAIC, _OPCODES_AFTER = 50829, 51009, 51022


@dataclass(frozen=True)
class Corrections:
    """Corrections of a DNG that matcap applies itself."""

    on_mosaic: tuple[GainMap, ...] = ()
    """Gain maps of OpcodeList2, for linear samples before demosaicing."""
    after_demosaic: tuple[GainMap, ...] = ()
    """Gain maps of OpcodeList3."""
    jpeg_xl: bool = False
    """Whether the raw picture is compressed with JPEG XL, which LibRaw cannot read."""
    active_area: tuple[int, int, int, int] | None = None
    """Top, left, bottom, right (the last two excluded) of the area that gain maps refer to, in the
    stored picture; None is all of it."""
    color: DngColor | None = None
    """White balance and colour matrix, or None if the file has no matrix."""
    notes: tuple[str, ...] = ()
    """Notes on corrections that are not applied."""

    @property
    def has_maps(self) -> bool:
        """Whether there are gain maps."""
        return bool(self.on_mosaic or self.after_demosaic)


def read_corrections(path: Path) -> Corrections:
    """Read a DNG's opcode lists, colour tags and compression.

    Raises:
        MatcapError: the tags or the gain maps are damaged. Ignoring them would attribute lens
            shading to the light, or the light's colour to the material.
    """
    import tifffile

    with decoding(path, "DNG"), tifffile.TiffFile(path) as file:
        page = raw_page(file)
        if page is None:
            return Corrections()
        on_mosaic, undone = parse_opcodes(_bytes(page, _OPCODES_ON_MOSAIC))
        after, also_undone = parse_opcodes(_bytes(page, _OPCODES_AFTER))
        asked = sorted(undone | also_undone)
        return Corrections(
            on_mosaic,
            after,
            int(page.compression) == _JPEG_XL,
            _active_area(page),
            dng_color(_values(page) | _values(file.pages.first)),
            tuple(f"The DNG asks for {what}, which was not applied." for what in asked),
        )


def raw_page(file: Any) -> TiffPage | None:  # noqa: ANN401
    """The largest raw picture of an open tifffile.TiffFile, or None."""
    pages = islice(_pages(file), _MOST_PAGES)
    raws = [page for page in pages if int(page.photometric) in (_CFA, _LINEAR_RAW)]
    return max(raws, key=lambda page: page.imagewidth * page.imagelength, default=None)


def _pages(file: Any) -> Iterator[Any]:  # noqa: ANN401
    for page in file.pages:
        yield page
        yield from page.pages or ()


def _values(page: Any) -> dict[int, Any]:  # noqa: ANN401
    return {tag.code: tag.value for tag in page.tags if tag.code in COLOR_TAGS}


def _active_area(page: Any) -> tuple[int, int, int, int] | None:  # noqa: ANN401
    if _ACTIVE_AREA not in page.tags:
        return None
    top, left, bottom, right = (int(edge) for edge in page.tags[_ACTIVE_AREA].value)
    if not (0 <= top < bottom <= page.imagelength and 0 <= left < right <= page.imagewidth):
        raise ValueError("the active area lies outside the picture")
    return top, left, bottom, right


def _bytes(page: Any, tag: int) -> bytes:  # noqa: ANN401
    """Bytes of an opcode list; of an empty one if the tag is absent."""
    return bytes(page.tags[tag].value) if tag in page.tags else bytes(4)
