"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from functools import wraps
from pathlib import Path
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


seeded = typed(values.seed)  # a parser for typer of seeds


class Normal(Enum):
    """Which way green points in a normal map."""

    gl = "gl"
    dx = "dx"


JsonOption = Annotated[bool, typer.Option("--json", help="Print the results as JSON.")]
StrictOption = Annotated[
    bool,
    typer.Option(
        "--strict", help="Count doubtful and failed verdicts as failures: exit code 3 or 4."
    ),
]
OverwriteOption = Annotated[
    bool,
    typer.Option("--overwrite", help="Replace what is there, even where it is something else."),
]
ReplaceOption = Annotated[
    bool,
    typer.Option("--overwrite", help="Replace a file that another program or command wrote."),
]
FovOption = Annotated[
    float | None,
    typer.Option(
        parser=in_range(1.0, 170.0),
        metavar="1..170",
        help="Field of view along the long side, degrees.",
    ),
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but failures.")]
LikeOption = Annotated[
    Path | None,
    typer.Option(
        metavar="PHOTO", help="Draw near this flash photograph instead of anywhere in the space."
    ),
]
SpreadOption = Annotated[
    float | None,
    typer.Option(
        "-t",
        parser=in_range(0.0, 1.0),
        metavar="0..1",
        show_default="0.3",
        help="How far from there to draw: 0 is the photograph's own place, 1 anywhere.",
    ),
]
