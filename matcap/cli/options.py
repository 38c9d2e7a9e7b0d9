"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from typer.core import TyperCommand

from matcap.brdf.folder import mapset_files

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


JsonOption = Annotated[bool, typer.Option("--json", help="Print the results as JSON.")]
StrictOption = Annotated[
    bool,
    typer.Option(
        "--strict", help="Count doubtful and failed verdicts as failures: exit code 3 or 4."
    ),
]
OverwriteOption = Annotated[
    bool,
    typer.Option("--overwrite", help="Replace existing outputs."),
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print only failures.")]


def printer(*, quiet: bool) -> Callable[[str], None]:
    """A function that prints lines on stderr; if quiet it does nothing."""
    return (lambda line: None) if quiet else (lambda line: typer.echo(line, err=True))


class PlainCommand(TyperCommand):
    """Typer's command, without `<bool>` in the help of flags."""

    def get_params(self, ctx: Any) -> list[Any]:  # noqa: ANN401
        """All parameters including `--help`, flags without a type."""
        params = super().get_params(ctx)
        for param in params:
            if getattr(param, "is_flag", False) and param.metavar is None:
                param.metavar = ""
        return params


def files_read(*given: Path | None) -> list[Path]:
    """Files among `given`, and the materials and map sets in given folders."""
    return [file for path in given if path is not None for file in _of(path)]


def _of(path: Path) -> Iterable[Path]:
    if not path.is_dir() and path.suffix.lower() != ".json":
        return [path]
    folder = path if path.is_dir() else path.parent
    sets = [file.stem for file in folder.glob("*.json")]
    maps = {file for name in sets for file in mapset_files(name)}
    return [file for file in folder.glob("*") if file.suffix == ".matcap" or file.name in maps]
