"""Errors of load_photo for files that it cannot use."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from matcap.errors import MatcapError

SHORTEST_SIDE = 64  # pixels: below this no texture is left to look at
MOST_PIXELS = 260_000_000  # the largest picture that is opened; a header may claim any size

READABLE = "give a DNG or other RAW, a JPEG, PNG, TIFF, HEIC, AVIF or WebP"
# How decoders call what they do not know, rather than what is broken.
_UNSUPPORTED = ("unsupported", "not supported", "not implemented", "cannot handle", "no decoding")


def check_size(path: Path, width: int, height: int) -> None:
    """Refuse pictures too small to hold a texture, or too large to be a photograph.

    Raises:
        MatcapError: the short side is under SHORTEST_SIDE, or there are over MOST_PIXELS.
    """
    if min(width, height) < SHORTEST_SIDE:
        raise MatcapError(
            f"the picture is {width} x {height} pixels, too small to hold a texture",
            where=str(path),
            remedy=f"give one of at least {SHORTEST_SIDE} pixels on its short side",
        )
    if width * height > MOST_PIXELS:
        raise MatcapError(
            f"the picture is {width} x {height} pixels, more than can be read",
            where=str(path),
            remedy=f"reduce it to under {MOST_PIXELS // 1_000_000} megapixels",
        )


@contextmanager
def decoding(path: Path, form: str) -> Iterator[None]:
    """Turn whatever a foreign decoder raises on a broken file into one MatcapError.

    Only calls into other libraries belong inside: they raise anything at all (struct.error,
    AssertionError, their own) when the bytes are not what they expected.
    """
    try:
        yield
    except MatcapError:
        raise
    except MemoryError as error:
        raise MatcapError(
            f"there is not enough memory to read this {form}",
            where=str(path),
            remedy="free some memory or reduce the picture",
        ) from error
    except Exception as error:
        if any(word in str(error).lower() for word in _UNSUPPORTED):
            raise unsupported(path, f"how this {form} file is coded") from error
        raise unreadable(path, form) from error


def unreadable(path: Path, form: str) -> MatcapError:
    """The file starts as a picture of this form and does not go on as one."""
    return MatcapError(
        f"the {form} file is truncated or damaged",
        where=str(path),
        remedy="copy it from the camera again",
    )


def unsupported(path: Path, what: str) -> MatcapError:
    """The file may be whole; how it is coded is not known here."""
    return MatcapError(
        f"{what} is not supported",
        where=str(path),
        remedy="export it as a JPEG, PNG or TIFF of 8 or 16 bits in RGB",
    )


def missing_extra(path: Path, form: str, extra: str) -> MatcapError:
    """The form is known, and what reads it is not installed."""
    return MatcapError(
        f"{form} needs a package that is not installed",
        where=str(path),
        remedy=f'run: pip install "matcap[{extra}]"',
    )
