"""What a photograph says of itself: orientation, field of view, flash (Exif 2.32)."""

from __future__ import annotations

import io
from dataclasses import dataclass
from math import atan, degrees
from pathlib import Path
from typing import Any, BinaryIO

_FILM_LONG_SIDE = 36.0  # mm, of the 35 mm frame that FocalLengthIn35mmFilm refers to


@dataclass(frozen=True)
class Exif:
    """The few tags that matter.

    Attributes:
        orientation: 1 to 8, how the stored picture lies; 1 is upright.
        fov: field of view across the long side, degrees, or None.
        flash_fired: or None where the file does not say.
        exposure: how much light it took in, in units that compare within a shoot: exposure time
            times sensitivity over the squared f-number; None where the file lacks one.
    """

    orientation: int = 1
    fov: float | None = None
    flash_fired: bool | None = None
    exposure: float | None = None


def fov_of_focal_length(focal_length: float) -> float:
    """Degrees across the long side of a 36 x 24 mm frame, from a focal length in mm, over 0."""
    return degrees(2.0 * atan(_FILM_LONG_SIDE / 2.0 / focal_length))


def read_exif(source: Path | bytes) -> Exif:
    """Read a file's tags, or a block of Exif bytes; what is absent or broken stays at its default.

    Never raises for what the file holds: a photograph with broken tags is still a photograph.
    """
    if isinstance(source, Path):
        with source.open("rb") as file:
            return _interpret(_tags(file))
    return _interpret(_tags(io.BytesIO(source.removeprefix(b"Exif\0\0"))))


def _exposure(tags: dict[str, Any]) -> float | None:
    time = _ratio(tags, "EXIF ExposureTime")
    sensitivity = _ratio(tags, "EXIF ISOSpeedRatings")
    aperture = _ratio(tags, "EXIF FNumber")
    if time is None or sensitivity is None or aperture is None:
        return None
    return time * sensitivity / aperture**2


def _ratio(tags: dict[str, Any], name: str) -> float | None:
    """The tag's first value, where it is a positive number."""
    try:
        value = float(tags[name].values[0])
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, ArithmeticError):
        return None
    return value if 0.0 < value < 1e9 else None


def _tags(file: BinaryIO) -> dict[str, Any]:
    import exifread

    try:
        return exifread.process_file(file, details=False, extract_thumbnail=False)
    except Exception:  # its parser raises anything at all (AssertionError, struct.error, ...)
        return {}


def _interpret(tags: dict[str, Any]) -> Exif:
    orientation = _number(tags, "Image Orientation")
    focal_length = _number(tags, "EXIF FocalLengthIn35mmFilm")
    flash = _number(tags, "EXIF Flash")
    return Exif(
        orientation=orientation if orientation in range(1, 9) else 1,
        # Zero means unknown; no lens for photographs is longer than 10 m.
        fov=fov_of_focal_length(focal_length) if 0 < focal_length < 10_000 else None,
        flash_fired=bool(flash & 1) if flash >= 0 else None,
        exposure=_exposure(tags),
    )


def _number(tags: dict[str, Any], name: str) -> int:
    """The tag's first value as an integer, or -1."""
    try:
        return int(tags[name].values[0])
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, ZeroDivisionError):
        return -1
