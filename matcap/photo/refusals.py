"""Errors of load_photo for files that it cannot use."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from matcap.errors import MatcapError

SHORTEST_SIDE = 64  # pixels, least short side
MOST_PIXELS = 260_000_000  # larger pictures are not opened; a header may claim any size

READABLE = "give a DNG or other RAW, a JPEG, PNG, TIFF, HEIC, AVIF, WebP, EXR or HDR"
# Words in decoders' errors for unsupported, rather than damaged, files.
_UNSUPPORTED = ("unsupported", "not supported", "not implemented", "cannot handle", "no decoding")


def check_size(path: Path, width: int, height: int) -> None:
    """Refuse pictures that are too small for a texture, or too large.

    Raises:
        MatcapError: the short side is less than SHORTEST_SIDE, or there are more than MOST_PIXELS.
    """
    if min(width, height) < SHORTEST_SIDE:
        raise MatcapError.at(
            path,
            f"the picture is {width} x {height} pixels, too small to hold a texture",
            f"give one of at least {SHORTEST_SIDE} pixels on its short side",
        )
    if width * height > MOST_PIXELS:
        raise MatcapError.at(
            path,
            f"the picture is {width} x {height} pixels, more than can be read",
            f"reduce it to under {MOST_PIXELS // 1_000_000} megapixels",
        )


@contextmanager
def decoding(path: Path, form: str) -> Iterator[None]:
    """Context that converts a decoder's exceptions on damaged files to MatcapError.

    For calls of other libraries only, which may raise anything (struct.error, AssertionError, ...).
    """
    try:
        yield
    except MatcapError:
        raise
    except MemoryError as error:
        raise MatcapError.at(
            path,
            f"there is not enough memory to read this {form}",
            "free some memory or reduce the picture",
        ) from error
    except Exception as error:
        if any(word in str(error).lower() for word in _UNSUPPORTED):
            raise unsupported(path, f"how this {form} file is coded") from error
        raise unreadable(path, form) from error


def unreadable(path: Path, form: str) -> MatcapError:
    """The error for a truncated or damaged file."""
    return MatcapError.at(
        path, f"the {form} file is truncated or damaged", "copy it from the camera again"
    )


def unsupported(path: Path, what: str) -> MatcapError:
    """The error for a file whose coding is not supported."""
    return MatcapError.at(
        path, f"{what} is not supported", "export it as a JPEG, PNG or TIFF of 8 or 16 bits in RGB"
    )


def missing_extra(path: Path, form: str, extra: str) -> MatcapError:
    """The error for a format whose reader is not installed."""
    return MatcapError.at(
        path, f"{form} needs a package that is not installed", f'run: pip install "matcap[{extra}]"'
    )
