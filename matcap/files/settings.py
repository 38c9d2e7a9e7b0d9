"""Settings that users choose, each defined once at a dataclass field; parsers of values."""

from __future__ import annotations

import ast
import difflib
import math
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from matcap.errors import UsageError
from matcap.files.names import shown

# Parsers of sizes, rectangles, seeds and durations that users type.
#
# Invalid text raises a ValueError with a sentence. Values that are parsed already are returned.

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
        raise ValueError(f"'{text}' has a side of zero; give 1 or more")
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


def sides(most: int) -> Callable[[str | Size], Size]:
    """A parser of sizes whose sides are at most `most`."""

    def parsed(text: str | Size) -> Size:
        value = size(text)
        if max(value.width, value.height) > most:
            raise ValueError(f"'{text}' has a side of more than {most}; give at most that")
        return value

    return parsed


def region(text: str | Rectangle) -> Rectangle:
    """'x,y,w,h' to a rectangle of the field."""
    if isinstance(text, Rectangle):
        return text
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"'{text}' is not a rectangle such as 100,0,512,512") from None
    if width < 1 or height < 1:
        raise ValueError(f"'{text}' has a side of zero or less; give 1 or more")
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


# Settings that users choose, each defined once, at the field of the frozen dataclass.
#
# detail: int | None = setting(None, least=64, most=8192)
# '''Texels along the photograph's long side.'''
#
# Type, range, choices, default and docstring are defined there only. The dataclass, the command
# line's options (cli/options.py), matcap.toml (batch/samples.py) and the reference pages use them.

_KINDS: Mapping[str, type] = {"int": int, "float": float, "bool": bool, "Path": Path}
_WORDS = {int: "a whole number", float: "a number", bool: "true or false"}
NUMBERS = (int, float)


@dataclass(frozen=True)
class Setting:
    """A setting: a field of a dataclass, with its constraints."""

    field: str
    name: str
    """Name that users type, with underscores."""
    kind: type
    """int, float, bool, Path or str, of the value before parsing."""
    default: Any
    help: str
    """Docstring of the field."""
    least: float = -math.inf
    """Least value of a number."""
    most: float = math.inf
    """Greatest value of a number."""
    words: tuple[str, ...] = ()
    """Choices of a text; empty allows any."""
    short: str = ""
    """One-letter form of the option."""
    metavar: str | None = None
    """Placeholder of its value in help."""
    otherwise: str = ""
    """Description of the default in help, where the default value does not show it."""
    parse: Callable[[Any], Any] | None = None
    """Parser of what users type (of the list, if `several`); raises ValueError."""
    several: bool = False
    """Whether the option may be given several times."""
    off: str | None = ""
    """Option that switches a flag off; "" is --no- and its name, None is no option."""
    group: str = ""
    """Group of the option in help; "" is the first."""

    @property
    def flag(self) -> str:
        """Name of the option: long, such as --time-limit, or short where `option` is."""
        return self.name if self.name.startswith("-") else f"--{self.name.replace('_', '-')}"

    def check(self, value: object, where: str) -> None:
        """Check a value against choices and limits; None is not checked against choices.

        Raises:
            UsageError: not a choice, out of range, or not finite.
        """
        if self.words and value is not None and value not in self.words:
            remedy = nearest(str(value), self.words)
            raise UsageError.at(where, f"there is no choice {_short(value)}", remedy)
        if isinstance(value, bool) or not isinstance(value, int | float):
            return
        if not (math.isfinite(value) and self.least <= value <= self.most):
            raise UsageError.at(
                where,
                f"{_short(value)} is out of range",
                f"give between {self.least:g} and {self.most:g}",
            )

    def number(self, text: Any) -> Any:  # noqa: ANN401
        """The number that a text gives; its range is check()'s.

        Raises:
            ValueError: it is none.
        """
        try:
            return self.kind(text)
        except ValueError as error:
            bounded = self.most < math.inf
            limits = f" between {self.least:.15g} and {self.most:.15g}" if bounded else ""
            raise ValueError(f"'{text}' is not {_WORDS[self.kind]}{limits}") from error

    def typed(self, value: Any, where: str) -> Any:  # noqa: ANN401
        """Convert a value from a file or from Python to the field's type, and check it.

        Raises:
            UsageError: a value of a wrong type, or one that check() refuses.
        """
        if self.several:
            value = [value] if isinstance(value, str) else value
            fits = isinstance(value, list | tuple) and all(isinstance(one, str) for one in value)
        elif self.parse is not None:
            fits = not isinstance(value, bool | dict)
        else:
            kinds = {float: (int, float), Path: (str, Path)}.get(self.kind, (self.kind,))
            fits = isinstance(value, kinds) and isinstance(value, bool) == (self.kind is bool)
        if not fits:
            wanted = "a list" if self.several else _WORDS.get(self.kind, "a text")
            raise UsageError.at(where, f"{self.name} is {_short(value)}", f"give {wanted}")
        try:
            if self.parse is not None:
                value = self.parse(value)
            elif self.kind in (float, Path):
                value = self.kind(value)
        except ValueError as error:
            raise UsageError.at(where, str(error), f"correct {self.name}") from error
        except (AttributeError, TypeError) as error:
            what = f"{self.name} is {_short(value)}"
            raise UsageError.at(where, what, "give a text") from error
        self.check(value, where)
        return value


def setting(default: Any, **rule: Any) -> Any:  # noqa: ANN401
    """A dataclass field that users can set; `rule` has Setting's entries from `least` on.

    Its entry `option` is the option's name where that is not the field's.
    """
    return field(default=default, metadata={"setting": rule})


@cache
def settings_in(kind: type) -> Mapping[str, Setting]:
    """The settings of a dataclass, by field name."""
    docs = field_docs(kind)
    settings = {}
    for one in fields(kind):
        if "setting" in one.metadata:
            rule = dict(one.metadata["setting"])
            first = re.split(r"\W", str(one.type), maxsplit=1)[0]
            about = (_KINDS.get(first, str), one.default, docs.get(one.name, ""))
            name = rule.pop("option", one.name)
            settings[one.name] = Setting(one.name, name, *about, **rule)
    return settings


class CheckedSettings:
    """Base of a dataclass of settings, which are checked when it is made.

    Raises:
        UsageError: see Setting.check.
    """

    def __post_init__(self) -> None:
        kind: type = type(self)
        for name, one in settings_in(kind).items():
            one.check(getattr(self, name), one.flag)


def typed_settings(kind: type, named: Mapping[str, Any]) -> dict[str, Any]:
    """Convert values by field name to the fields' types; others are returned unchanged.

    Raises:
        UsageError: a name is no field's; see Setting.typed.
    """
    known = settings_in(kind)
    names = [one.name for one in fields(kind)]
    for name in named:
        if name not in names:
            raise UsageError(f"there is no setting {shown(name)}", remedy=nearest(name, names))
    return {
        name: known[name].typed(value, known[name].flag)
        if name in known and value is not None
        else value
        for name, value in named.items()
    }


def field_docs(kind: type) -> dict[str, str]:
    """Docstrings of a class's fields, by name, each on one line."""
    return _docs_in(kind.__module__).get(kind.__qualname__, {})


@cache
def _docs_in(module: str) -> dict[str, dict[str, str]]:
    """field_docs of all classes of a module."""
    file = Path(str(sys.modules[module].__file__))
    by_class = {}
    for node in ast.parse(file.read_bytes()).body:
        if isinstance(node, ast.ClassDef):
            docs: dict[str, str] = {}
            names: list[str] = []
            for line in node.body:
                if isinstance(line, ast.AnnAssign | ast.Assign):
                    target = line.target if isinstance(line, ast.AnnAssign) else line.targets[0]
                    names.append(ast.unparse(target))
                elif isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant):
                    # A docstring also applies to fields above it that have none.
                    docs |= dict.fromkeys(names, " ".join(str(line.value.value).split()))
                    names = []
            by_class[node.name] = docs
    return by_class


def nearest(name: str, words: Iterable[str], otherwise: str = "") -> str:
    """Remedy for an unknown word: the closest known one, or the list of all.

    A word that begins `name`, or that `name` begins, is close. `otherwise` follows the list.
    """
    words, name = list(words), name.strip().lower()
    begun = [word for word in words if name and (word.startswith(name) or name.startswith(word))]
    close = begun or difflib.get_close_matches(name, words, n=1)
    if close:
        return f"did you mean {close[0]!r}"
    return f"choose from {', '.join(words)} {otherwise}".rstrip()


def known(name: str, words: Iterable[str], where: str) -> str:
    """Return `name` if it is one of `words`.

    Raises:
        UsageError: it is not.
    """
    words = list(words)
    if name not in words:
        raise UsageError.at(where, f"there is no '{name}'", nearest(name, words))
    return name


def refuse_options(given: Mapping[str, object], what: str, remedy: str) -> None:
    """Raise UsageError for the first option that is given, which is not None or False."""
    for option, value in given.items():
        if value is not None and value is not False:
            raise UsageError.at(option, what, remedy)


def _short(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else shown(value)
