"""The commands, from their own signatures.

Read from what the commands declare and not from the parser made of it, which differs from one
typer to the next.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import typer
from typer.models import ArgumentInfo, OptionInfo

from reference.docstrings import table

_HEAD = """\
# Commands

`matcap COMMAND --help` prints the same. After `matcap --install-completion` your shell completes
commands and options.
"""
_KINDS = {int: "INTEGER", float: "FLOAT", Path: "PATH", str: "TEXT"}


@dataclass(frozen=True)
class Parameter:
    """A parameter of a command, as its function declares it."""

    name: str
    kind: Any
    info: ArgumentInfo | OptionInfo
    default: object

    @property
    def required(self) -> bool:
        """Whether it must be given."""
        return self.default is inspect.Parameter.empty

    @property
    def flag(self) -> bool:
        """Whether it takes no value."""
        return self.kind is bool

    @property
    def value(self) -> str:
        """What it takes: INTEGER, PATH, a|b|c, or what the command calls it."""
        if self.info.metavar:
            return str(self.info.metavar)
        kind = get_args(self.kind)[0] if get_origin(self.kind) is list else self.kind
        if isinstance(kind, type) and issubclass(kind, Enum):
            return "|".join(str(choice.value) for choice in kind)
        return _KINDS.get(kind, "VALUE")

    @property
    def shown(self) -> str:
        """Its name in a usage line or in the table."""
        if isinstance(self.info, ArgumentInfo):
            name = str(self.info.metavar or self.name.upper())
            return name if self.required or name.startswith("[") else f"[{name}]"
        # Inside Annotated the first name stands where typer keeps defaults.
        first = [self.info.default] if isinstance(self.info.default, str) else []
        names = [*first, *(self.info.param_decls or ())]
        if not names:
            plain = self.name.replace("_", "-")
            # As typer has it: a switch without a name of its own can be switched off, too.
            names = [f"--{plain}", f"--no-{plain}"] if self.flag else [f"--{plain}"]
        names = [part for name in names for part in name.split("/")]
        documented = ", ".join(f"`{name}`" for name in names)
        return documented if self.flag else f"{documented} `{self.value}`"

    @property
    def otherwise(self) -> str:
        """What goes without saying."""
        if isinstance(self.info.show_default, str):
            return self.info.show_default
        value = getattr(self.default, "value", self.default)
        if self.required or value is None or isinstance(value, bool):
            return ""
        return f"`{value}`"


def page() -> str:
    """The page, in Markdown."""
    from matcap.cli.main import command_line

    callback = command_line().registered_callback
    assert callback is not None
    assert callback.callback is not None
    about = f"{command_line().info.help}\n\n{command_line().info.epilog}"
    parts = [_HEAD, _section("matcap", callback.callback, about=about, group=True)]
    parts += [_section(name, function) for name, function in _commands(command_line(), "matcap")]
    return "\n".join(parts)


def _commands(app: typer.Typer, prefix: str) -> Iterator[tuple[str, Callable[..., Any]]]:
    """(name, function) of all that do something, in the order of their registration."""
    for command in app.registered_commands:
        assert command.callback is not None
        name = command.name or command.callback.__name__.replace("_", "-")
        yield f"{prefix} {name}", command.callback
    for group in app.registered_groups:
        assert group.typer_instance is not None
        yield from _commands(group.typer_instance, f"{prefix} {group.name}")


def _section(
    name: str, function: Callable[..., Any], *, about: str | None = None, group: bool = False
) -> str:
    """Heading, usage, help and a table of parameters."""
    taken = list(parameters(function))
    arguments = [one.shown for one in taken if isinstance(one.info, ArgumentInfo)]
    usage = [name, "[OPTIONS]", *(["COMMAND", "..."] if group else []), *arguments]
    text = inspect.cleandoc(about or function.__doc__ or "")
    lines = [f"## {name}", "", "```", " ".join(usage), "```", "", text, ""]
    if taken:
        lines += table(["", "", "default"], map(_row, taken))
    return "\n".join(lines)


def parameters(function: Callable[..., Any]) -> Iterator[Parameter]:
    """What a command takes, in its order."""
    hints = get_type_hints(function, include_extras=True)
    for name, stated in inspect.signature(function).parameters.items():
        if get_origin(hints[name]) is not Annotated:
            continue  # the context
        kind, *extras = get_args(hints[name])
        info = next(one for one in extras if isinstance(one, ArgumentInfo | OptionInfo))
        if get_origin(kind) in (Union, UnionType):
            (kind,) = (part for part in get_args(kind) if part is not NoneType)
        yield Parameter(name, kind, info, stated.default)


def _row(one: Parameter) -> tuple[str, str, str]:
    """A parameter as a row of the table."""
    name = f"`{one.shown}`" if isinstance(one.info, ArgumentInfo) else one.shown
    return name, one.info.help or "", one.otherwise
