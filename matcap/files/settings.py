"""Settings that users choose, each defined once, at the field of the frozen dataclass.

    detail: int | None = setting(None, least=64, most=8192)
    '''Texels along the photograph's long side.'''

Type, range, choices, default and docstring are defined there only. The dataclass, the command
line's options (cli/fields.py), matcap.toml (batch/settings.py) and the reference pages use them.
"""

from __future__ import annotations

import ast
import difflib
import math
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import Any

from matcap.errors import UsageError
from matcap.files.names import shown

_KINDS: Mapping[str, type] = {"int": int, "float": float, "bool": bool, "Path": Path}
_WORDS = {int: "a whole number", float: "a number", bool: "true or false"}


@dataclass(frozen=True)
class SettingRule:
    """Constraints and names of a setting."""

    least: float = -math.inf
    """Least value of a number."""
    most: float = math.inf
    """Greatest value of a number."""
    words: tuple[str, ...] = ()
    """Choices of a text; empty allows any."""
    option: str = ""
    """Name of the option; "" is the field's name."""
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


def setting(default: Any, **rule: Any) -> Any:  # noqa: ANN401
    """A dataclass field that users can set; `rule` has the fields of SettingRule."""
    return field(default=default, metadata={"rule": SettingRule(**rule)})


@dataclass(frozen=True)
class Setting:
    """A setting of a dataclass."""

    field: str
    """Name of the field."""
    name: str
    """Name that users type, with underscores."""
    kind: type
    """int, float, bool, Path or str, of the value before parsing."""
    default: Any
    help: str
    """Docstring of the field."""
    rule: SettingRule

    @property
    def flag(self) -> str:
        """Name of the option: long, such as --time-limit, or short where `option` is."""
        return self.name if self.name.startswith("-") else f"--{self.name.replace('_', '-')}"

    def check(self, value: object, where: str) -> None:
        """Check a value against choices and limits; None is not checked against choices.

        Raises:
            UsageError: not a choice, out of range, or not finite.
        """
        rule = self.rule
        if rule.words and value is not None and value not in rule.words:
            remedy = nearest(str(value), rule.words)
            raise UsageError.at(where, f"there is no {self.name} {_short(value)}", remedy)
        if isinstance(value, bool) or not isinstance(value, int | float):
            return
        if not (math.isfinite(value) and rule.least <= value <= rule.most):
            raise UsageError.at(
                where,
                f"{_short(value)} is out of range",
                f"give between {rule.least:g} and {rule.most:g}",
            )

    def typed(self, value: Any, where: str) -> Any:  # noqa: ANN401
        """Convert a value from a file or from Python to the field's type, and check it.

        Raises:
            UsageError: a value of a wrong type, or one that check() refuses.
        """
        if self.rule.several:
            value = [value] if isinstance(value, str) else value
            fits = isinstance(value, list | tuple) and all(isinstance(one, str) for one in value)
        elif self.rule.parse is not None:
            fits = not isinstance(value, bool | dict)
        else:
            kinds = {float: (int, float), Path: (str, Path)}.get(self.kind, (self.kind,))
            fits = isinstance(value, kinds) and isinstance(value, bool) == (self.kind is bool)
        if not fits:
            wanted = "a list" if self.rule.several else _WORDS.get(self.kind, "a text")
            raise UsageError.at(where, f"{self.name} is {_short(value)}", f"give {wanted}")
        try:
            if self.rule.parse is not None:
                value = self.rule.parse(value)
            elif self.kind in (float, Path):
                value = self.kind(value)
        except ValueError as error:
            raise UsageError.at(where, str(error), f"correct {self.name}") from error
        except (AttributeError, TypeError) as error:
            what = f"{self.name} is {_short(value)}"
            raise UsageError.at(where, what, "give a text") from error
        self.check(value, where)
        return value


@cache
def settings_in(kind: type) -> Mapping[str, Setting]:
    """The settings of a dataclass, by field name."""
    docs = field_docs(kind)
    settings = {}
    for one in fields(kind):
        if "rule" in one.metadata:
            rule: SettingRule = one.metadata["rule"]
            first = re.split(r"\W", str(one.type), maxsplit=1)[0]
            settings[one.name] = Setting(
                one.name, rule.option or one.name, _KINDS.get(first, str), one.default,
                docs.get(one.name, ""), rule,
            )  # fmt: skip
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


def nearest(name: str, words: Iterable[str]) -> str:
    """Remedy for an unknown word: the closest known one, or the list of all."""
    words = list(words)
    close = difflib.get_close_matches(name.lower(), words, n=1, cutoff=0.5)
    return f"did you mean {close[0]!r}" if close else f"choose from {', '.join(words)}"


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
