"""Options that several commands share, and options generated from the fields of settings."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from functools import wraps
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand, TyperOption

from matcap.errors import UsageError
from matcap.files.settings import NUMBERS, Setting, settings_in

GROUPS = ("Everyday", "Several photographs", "Output", "Decoder", "Advanced")
EVERYDAY, SEVERAL, OUTPUT, DECODER, ADVANCED = GROUPS
ALL = "--help-all"
_ENDLESS = 1e5  # end of a range that help does not show
T = TypeVar("T")


def typed(parse: Callable[[Any], T]) -> Callable[[Any], T]:
    """A parser for typer: a ValueError of `parse` is reported as a wrong option."""

    @wraps(parse)
    def parsed(text: Any) -> T:  # noqa: ANN401
        try:
            return parse(text)
        except ValueError as error:
            raise typer.BadParameter(str(error)) from error

    return parsed


JsonOption = Annotated[
    bool, typer.Option("--json", help="Print the results as JSON.", rich_help_panel=OUTPUT)
]
StrictOption = Annotated[
    bool,
    typer.Option(
        "--strict",
        help="Count doubtful and failed verdicts as failures: exit code 3 or 4.",
        rich_help_panel=OUTPUT,
    ),
]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace existing outputs.")]
QuietOption = Annotated[
    bool, typer.Option("--quiet", "-q", help="Print only failures.", rich_help_panel=OUTPUT)
]


def printer(*, quiet: bool) -> Callable[[str], None]:
    """A function that prints lines on stderr; if quiet it does nothing."""
    return (lambda line: None) if quiet else (lambda line: typer.echo(line, err=True))


class PlainCommand(TyperCommand):
    """Typer's command: options in groups, the everyday ones first, a sentence each.

    Of a command with many, `--help` shows the everyday ones and names the others, which
    `--help-all` shows. The reference page has the whole texts. Flags have no `<bool>`, paragraphs
    no line breaks.
    """

    _whole = False

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401
        """Parse the arguments; `--help` and `--help-all` are one option.

        Raises:
            UsageError: of two options that exclude each other (--metal, --dielectric) both are
                given; of --x and --no-x the last counts, as everywhere.
        """
        self._whole = ALL in args
        for param in self.params:
            both = [*param.opts, *param.secondary_opts]
            if {*both} <= {*args} and not both[-1].startswith("--no-") and param.secondary_opts:
                raise UsageError.at(" ".join(both), "one excludes the other", "give one of them")
        return super().parse_args(ctx, args)

    def get_params(self, ctx: Any) -> list[Any]:  # noqa: ANN401
        """All parameters, flags without a type, `--help` hidden."""
        params = super().get_params(ctx)
        for param in params:
            if getattr(param, "is_flag", False) and param.metavar is None:
                param.metavar = ""
            if isinstance(param, TyperOption) and ALL in param.opts:
                param.hidden = True  # the epilogue says it
            if isinstance(param, TyperOption) and not (param.required or param.multiple):
                vars(param).setdefault("process_value", _unless_absent(param.process_value))
        return params

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401
        """Print the help."""
        paragraphs = (self.help or "").split("\n\n")
        self.help = "\n\n".join(" ".join(each.split()) for each in paragraphs)
        self.epilog = f"More of each option: docs/reference/commands.md, matcap {self.name}."
        options = [param for param in self.params if isinstance(param, TyperOption)]
        many = any(param.rich_help_panel in (DECODER, ADVANCED) for param in options)
        others: dict[str, list[str]] = {name: [] for name in GROUPS[1:]}
        for param in options:
            param.help = re.split(r"[.;] ", param.help or "")[0].rstrip(".") + "."
            if many:
                param.rich_help_panel = param.rich_help_panel or EVERYDAY
                param.hidden = not self._whole and param.rich_help_panel != EVERYDAY
            if param.hidden:
                others[str(param.rich_help_panel)].append(param.opts[0])
        if any(others.values()):
            named = (f"{name.lower()}: {', '.join(own)}" for name, own in others.items() if own)
            self.epilog = f"By {ALL} also {'; '.join(named)}."
        panels = [getattr(param, "rich_help_panel", None) or EVERYDAY for param in self.params]
        order = sorted(range(len(panels)), key=lambda at: GROUPS.index(panels[at]))
        self.params = [self.params[at] for at in order]
        super().format_help(ctx, formatter)


def _unless_absent(process: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """Processing of an option's value that leaves None as it is.

    Typer would build a validator of each option, which takes a sixth of a second for all of one
    command.
    """
    return lambda context, value: None if value is None else process(context, value)


def files_read(*given: Path | None) -> list[Path]:
    """Files among `given`, and the materials and map sets in given folders."""
    return [file for path in given if path is not None for file in _of(path)]


def _of(path: Path) -> Iterable[Path]:
    if not path.is_dir() and path.suffix.lower() != ".json":
        return [path]
    folder = path if path.is_dir() else path.parent
    from matcap.brdf.folder import mapset_files

    sets = [file.stem for file in folder.glob("*.json")]
    maps = {file for name in sets for file in mapset_files(name)}
    return [file for file in folder.glob("*") if file.suffix == ".matcap" or file.name in maps]


# Options generated from the fields of settings (files/settings.py), their only definition.
#
# A command marks their position in its signature:
#
# @with_settings
# def capture(photos: ..., given: Annotated[Given, Fields(CaptureSettings)] = NOTHING) -> None:
#
# and receives those that the user gave, by field.

Given = Mapping[str, Any]
NOTHING: Given = MappingProxyType({})


class Fields:
    """Marker in a signature for dataclasses' settings: `only` some, or all `but` some."""

    def __init__(self, *kinds: type, but: tuple[str, ...] = (), only: tuple[str, ...] = ()) -> None:
        settings = {name: one for kind in kinds for name, one in settings_in(kind).items()}
        self.settings = {
            n: one for n, one in settings.items() if n not in but and n in (only or settings)
        }


def with_settings(command: Callable[..., None]) -> Callable[..., None]:
    """The command with an option for each setting that its signature marks."""
    hints = get_type_hints(command, include_extras=True)
    shown: list[inspect.Parameter] = []
    groups: dict[str, Fields] = {}
    for name, one in inspect.signature(command).parameters.items():
        extra = get_args(hints[name])[-1] if get_origin(hints[name]) is Annotated else None
        if isinstance(extra, Fields):
            groups[name] = extra
            shown += [_parameter(setting) for setting in extra.settings.values()]
        else:
            shown.append(one.replace(annotation=hints[name]))

    @wraps(command)
    def called(context: typer.Context, **options: Any) -> None:  # noqa: ANN401
        for group, stated in groups.items():
            taken = {name: options.pop(name) for name in stated.settings}
            options[group] = {
                name: _plain(stated.settings[name], value)
                for name, value in taken.items()
                if getattr(context.get_parameter_source(name), "name", "") != "DEFAULT"
            }
        command(**options)

    keyword = inspect.Parameter.KEYWORD_ONLY
    keywords = [one.replace(kind=keyword) for one in shown]
    keywords.append(inspect.Parameter("context", keyword, annotation=typer.Context))
    called.__dict__["__signature__"] = inspect.Signature(keywords)
    called.__annotations__ = {one.name: one.annotation for one in keywords} | {"return": None}
    return called


def chosen(kind: Callable[..., T], given: Given) -> T:
    """Instance of `kind` from the given options; options of other dataclasses are ignored."""
    names = {one.name for one in fields(cast(Any, kind))}
    return kind(**{name: value for name, value in given.items() if name in names})


def _parameter(one: Setting) -> inspect.Parameter:
    """Option of a setting."""
    more: dict[str, Any] = {}
    kind: Any = one.kind
    metavar = one.metavar
    default = None if one.otherwise else _text_of_default(one.default)
    if one.words:
        kind, metavar = str, "|".join(one.words)  # the settings say which is meant
    elif one.several:
        kind = list[str]
    elif one.parse is not None:
        kind, more = Any, {"parser": typed(one.parse)}
    elif kind in NUMBERS:
        kind, more = Any, {"parser": typed(one.number)}
        if math.isfinite(one.least):
            # The range, unless nobody reaches its end.
            limits = f"{one.least:g}..{one.most:g}" if one.most < _ENDLESS else "N"
            metavar = metavar or limits
    off = f"--no-{one.flag[2:]}" if one.off == "" else one.off
    flag = f"{one.flag}/{off}" if kind is bool and off else one.flag
    names = [flag, *([one.short] if one.short else [])]
    option: Any = typer.Option
    shown = one.otherwise or default is not None
    more |= {"rich_help_panel": one.group or None}
    stated = option(*names, help=one.help, metavar=metavar, show_default=shown, **more)
    return inspect.Parameter(
        one.field,
        inspect.Parameter.KEYWORD_ONLY,
        default=default,
        annotation=Annotated[kind | None, stated],
    )


def _text_of_default(default: object) -> str | None:
    """A default value as users would type it; None for None, flags and empty values."""
    if default is None or isinstance(default, bool) or default in ((), ""):
        return None
    if isinstance(default, tuple):
        return "x".join(str(part) for part in default)
    return str(default)


def _plain(one: Setting, value: Any) -> Any:  # noqa: ANN401
    """Typer's value converted to the field's type; numbers are checked."""
    if isinstance(value, int | float):
        one.check(value, one.flag)
    if one.several and one.parse is not None:
        return one.parse(value)
    return Path(value) if one.kind is Path and one.parse is None else value
