"""Parsers of sizes, rectangles, seeds and durations that users type.

Invalid text raises a ValueError with a sentence. Values that are parsed already are returned.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

_SECONDS = {"": 1.0, "s": 1.0, "m": 60.0, "h": 3600.0}
_KILO = 1024  # texels: 2K is 2048
COORDINATE_LIMIT = 2**40  # texels, largest magnitude of coordinates of the endless field
SEED_LIMIT = 2**63  # seeds are in [-SEED_LIMIT, SEED_LIMIT)
BRIGHTEST = 1e18  # radiance: squares of more overflow float32; the sun has 2e9 cd/m2


class Size(NamedTuple):
    """A rectangle's sides in texels."""

    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.width}x{self.height}"


@dataclass(frozen=True)
class Rectangle:
    """Texels of the endless field, or pixels of a photograph.

    [x, x + width) by [y, y + height); y points down.
    """

    x: int
    y: int
    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.x},{self.y},{self.width},{self.height}"

    def grown(self, by: int) -> Rectangle:
        """The rectangle extended by `by` texels on every side."""
        return Rectangle(self.x - by, self.y - by, self.width + 2 * by, self.height + 2 * by)

    def coarser(self, bits: int) -> Rectangle:
        """The texels of a grid 2^bits times as coarse that the rectangle overlaps."""
        x, y = self.x >> bits, self.y >> bits
        right, bottom = -(-(self.x + self.width) >> bits), -(-(self.y + self.height) >> bits)
        return Rectangle(x, y, right - x, bottom - y)

    def united(self, other: Rectangle) -> Rectangle:
        """The bounding rectangle of both."""
        x, y = min(self.x, other.x), min(self.y, other.y)
        right = max(self.x + self.width, other.x + other.width)
        bottom = max(self.y + self.height, other.y + other.height)
        return Rectangle(x, y, right - x, bottom - y)

    def within(self, outer: Rectangle) -> tuple[slice, slice]:
        """Slices (rows, columns) of this rectangle in an array that covers `outer`."""
        x, y = self.x - outer.x, self.y - outer.y
        return slice(y, y + self.height), slice(x, x + self.width)


DEFAULT_SIZE = Size(1024, 1024)


def bounded(value: object, name: str, least: float, most: float) -> float:
    """Check a number from a file.

    Raises:
        ValueError: not a number, NaN, or outside [least, most].
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{name} is {str(value)[:40]!r}, no number")
    if not least <= value <= most:
        raise ValueError(f"{name} is {value:.4g}, not from {least:g} to {most:g}")
    return float(value)


def whole(value: object, name: str, least: int, most: int) -> int:
    """Check an integer from a file.

    Raises:
        ValueError: not an integer, or outside [least, most].
    """
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"{name} is {str(value)[:40]!r}, no whole number")
    if not least <= value <= most:
        raise ValueError(f"{name} is {str(value)[:40]}, not from {least} to {most}")
    return value


def size(text: str | int | Sequence[int]) -> Size:
    """'4096x256' or [4096, 256] to 4096 by 256; 512 to 512 by 512; '4K' to 4096 by 4096."""
    text = str(text) if isinstance(text, str | int) else "x".join(str(part) for part in text)
    match = re.fullmatch(r"(\d{1,18})([kK]?)(?:[xX](\d{1,18})([kK]?))?", text.strip())
    if not match:
        raise ValueError(f"'{text}' is not a size such as 4096x256, 2K or 4K")
    width = int(match[1]) * (_KILO if match[2] else 1)
    height = int(match[3]) * (_KILO if match[4] else 1) if match[3] else width
    if min(width, height) < 1:
        raise ValueError(f"'{text}' has a side of zero")
    return Size(width, height)


def seed(text: str | int) -> int:
    """'7' to a seed, from -2^63 to 2^63 - 1."""
    if isinstance(text, int):
        return text
    if not re.fullmatch(r"\s*[+-]?\d{1,30}\s*", text):
        raise ValueError(f"'{text[:40]}' is not a whole number")
    if not -SEED_LIMIT <= int(text) < SEED_LIMIT:
        raise ValueError(f"'{text}' is out of range; give one from -2^63 to 2^63 - 1")
    return int(text)


def number(least: float, most: float) -> Callable[[str | float], float]:
    """A parser of numbers in [least, most]."""

    def parsed(text: str | float) -> float:
        try:
            value = float(text)
        except ValueError:
            raise ValueError(f"'{str(text)[:40]}' is not a number") from None
        if not least <= value <= most:
            raise ValueError(f"'{text}' is not from {least:g} to {most:g}")
        return value

    return parsed


def sides(most: int) -> Callable[[str | Size], Size]:
    """A parser of sizes whose sides are at most `most`."""

    def parsed(text: str | Size) -> Size:
        value = size(text)
        if max(value.width, value.height) > most:
            raise ValueError(f"'{text}' has a side of more than {most}")
        return value

    return parsed


def region(text: str | Rectangle) -> Rectangle:
    """'x,y,w,h' to a rectangle of the field."""
    if isinstance(text, Rectangle):
        return text
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"'{text}' is not a rectangle such as -100,0,512,512") from None
    if width < 1 or height < 1:
        raise ValueError(f"'{text}' has a side of zero or less")
    if max(abs(x), abs(y), abs(x + width), abs(y + height)) > COORDINATE_LIMIT:
        raise ValueError(f"'{text}' reaches outside the field, -2^40 to 2^40")
    return Rectangle(x, y, width, height)


def duration(text: str | float) -> float:
    """'90', '90s', '1.5m' to seconds."""
    if isinstance(text, int | float):
        return float(text)
    match = re.fullmatch(r"(\d+\.?\d*|\.\d+)\s*([smh]?)", text.strip())
    seconds = float(match[1]) * _SECONDS[match[2]] if match else math.nan
    if not 0 < seconds < math.inf:
        raise ValueError(f"'{text}' is not a time such as 90s or 1.5m")
    return seconds


def spoken_duration(seconds: float) -> str:
    """Seconds as text: 42 s, 12 min, 1.5 h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
