"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Annotated, Any, TypeVar

import typer

from matcap.files import values

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


def in_range(least: float, most: float) -> Callable[[Any], float]:
    """A parser for typer of finite numbers within limits, which metavar or help state."""
    return typed(values.number(least, most))


JsonOption = Annotated[bool, typer.Option("--json", help="Print the results as JSON.")]
StrictOption = Annotated[
    bool,
    typer.Option(
        "--strict", help="Count doubtful and failed verdicts as failures: exit code 3 or 4."
    ),
]
OverwriteOption = Annotated[
    bool,
    typer.Option("--overwrite", help="Replace existing outputs, even of another kind."),
]
ReplaceOption = Annotated[
    bool,
    typer.Option("--overwrite", help="Replace a file that another program or command wrote."),
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print only failures.")]
