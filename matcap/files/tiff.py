"""The picture of a TIFF file that is meant, and what OpenImageIO leaves undone when it reads it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# TIFF 6.0, and the supplements 1 and 2: PhotometricInterpretation.
WHITE_IS_ZERO, GREYS, _MASK = 0, (0, 1), 4
NO_RGB = {5: "CMYK", 8: "CIELAB", 9: "ICCLAB"}
_REDUCED, _IS_MASK = 1, 4  # bits of NewSubfileType
_MOST_PAGES = 64  # read at most; a damaged file may claim any number
_FORMATS, _FLOATING = (1, 2, 3, 4), 3  # SampleFormat: unsigned, signed, floating, undefined
_JPEGS = (6, 7)  # compressions
# Compressions that every OpenImageIO decodes; a failure with others means unsupported.
_USUAL = {1, 2, 3, 4, 5, 6, 7, 8, 32771, 32773, 32946}
_ORIENTATION = 274  # a tag
_MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


@dataclass(frozen=True)
class TiffPicture:
    """The picture of a TIFF file that is read; the defaults are another format's only one."""

    index: int = 0
    """Index of its page."""
    compression: str = ""
    """Name of its compression."""
    usual: bool = True
    """Whether every OpenImageIO decodes that."""
    orientation: int | None = None
    """EXIF's, of the page itself, or None."""
    photometric: int = 2
    """PhotometricInterpretation; 2 is RGB."""
    samples: int = 3
    """Number of channels."""
    refused: str = ""
    """What it is, if that is not supported: "a TIFF of ...", or ""."""
    notes: tuple[str, ...] = ()
    """Notes on other pages."""

    def as_meant(self, stored: NDArray[Any], alpha: int) -> NDArray[Any]:
        """Rows (n, W, C) as OpenImageIO reads them, with stored white as the largest value.

        Where WhiteIsZero, OpenImageIO inverts all channels of up to 8 bits, and none of others.

        Args:
            alpha: index of the channel of alpha, or negative.
        """
        if self.photometric != WHITE_IS_ZERO:
            return stored
        eight = stored.dtype == np.uint8
        wrong = [c for c in range(stored.shape[-1]) if (c == alpha) == eight]
        meant = stored.copy()
        largest = np.iinfo(stored.dtype).max if stored.dtype.kind == "u" else 1
        meant[..., wrong] = stored.dtype.type(largest) - meant[..., wrong]
        return meant


def is_tiff(head: bytes) -> bool:
    """Whether a file that begins with these bytes is a TIFF."""
    return head.startswith(_MAGIC)


def meant_picture(path: Path) -> TiffPicture:
    """The largest page that is neither a thumbnail nor a mask, the first of equals.

    Raises:
        Exception: of any kind where the file is damaged.
    """
    import tifffile

    with tifffile.TiffFile(path) as file:
        pages: list[Any] = list(islice(file.pages, _MOST_PAGES))
        sizes = [page.imagewidth * page.imagelength for page in pages]
        whole = [
            index
            for index, page in enumerate(pages)
            if not int(page.subfiletype) & (_REDUCED | _IS_MASK) and int(page.photometric) != _MASK
        ]
        chosen = max(whole or range(len(pages)), key=lambda index: (sizes[index], -index))
        page = pages[chosen]
        inside = [sub for each in pages for sub in islice(each.pages or (), _MOST_PAGES)]
        larger = [sub for sub in inside if sub.imagewidth * sub.imagelength > sizes[chosen]]
        photometric, code = int(page.photometric), int(page.compression)
        bits, form = int(page.bitspersample), int(page.sampleformat)
        equal = sum(sizes[index] == sizes[chosen] for index in whole)
        refused = ""
        if form not in _FORMATS or (form == _FLOATING and bits not in (16, 32, 64)):
            refused = f"a TIFF of {bits} bits in sample format {form}"
        elif larger:
            refused = "a TIFF whose picture is in a sub-directory behind a smaller one"
        elif photometric in NO_RGB:
            refused = f"a TIFF of {NO_RGB[photometric]} colours"
        return TiffPicture(
            chosen,
            str(getattr(page.compression, "name", code)).upper(),
            code in _USUAL and not (code in _JPEGS and bits != 8),
            _orientation(page),
            photometric,
            int(page.samplesperpixel),
            refused,
            (f"The file holds {equal} pictures: the first is read.",) if equal > 1 else (),
        )


def _orientation(page: Any) -> int | None:  # noqa: ANN401
    tag = page.tags.get(_ORIENTATION)
    return int(tag.value) if tag is not None and tag.value in range(1, 9) else None
