"""`matcap doctor`: what is installed, and whether it works."""

from __future__ import annotations

from typing import Annotated

import typer

from matcap.cli.options import JsonOption


def doctor(
    json: JsonOption = False,
    self_test: Annotated[
        bool,
        typer.Option("--self-test/--no-self-test", help="Also run every step on a small material."),
    ] = True,
) -> None:
    """Print versions, devices and extras, and test whether all of it works.

    Exits with 3 if something is missing or broken.
    """
    from matcap.cli.diagnosis import as_text, diagnose
    from matcap.errors import ExitCode

    diagnosis = diagnose(self_test=self_test)
    if json:
        from json import dumps

        typer.echo(dumps(diagnosis, indent=2))
    else:
        typer.echo(as_text(diagnosis))
    raise typer.Exit(ExitCode.DONE if diagnosis["healthy"] else ExitCode.NOTHING_SUCCEEDED)
