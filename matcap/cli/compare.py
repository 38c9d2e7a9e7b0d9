"""`matcap compare`: two captures side by side."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from matcap.cli.options import JsonOption, QuietOption
from matcap.errors import UsageError


def compare(
    first: Annotated[
        Path, typer.Argument(metavar="A", help="A capture's folder, or its .matcap file.")
    ],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another one.")],
    photo: Annotated[
        list[Path] | None,
        typer.Option(help="A photograph to show beside both; given twice, of A and of B."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="The picture, a PNG.")] = Path(
        "compared.png"
    ),
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Show two captures, or two versions of one, under the same lights, with their verdicts."""
    from matcap.capture.compare import Compared, comparison
    from matcap.files.staging import check_writable, staged_file
    from matcap.photo.load import load_photo

    photos = list(photo or [])
    if len(photos) > 2:
        raise UsageError("there are more than two", where="--photo", remedy="give one or two")
    check_writable(out.parent, 10_000_000, [out.name])
    captures = [Compared.open(path) for path in (first, second)]
    read = [load_photo(path, long_side=1024, noise=False) for path in photos]
    sheet = comparison(captures, read * 2 if len(read) == 1 else read)
    with staged_file(out) as file:
        sheet.save(file, "PNG")
    if as_json:
        told = [{"name": one.name, "verdict": one.verdict} for one in captures]
        typer.echo(json.dumps({"picture": str(out), "captures": told}, indent=2))
    elif not quiet:
        for one in captures:
            typer.echo(one.title(), err=True)
        typer.echo(f"wrote {out}", err=True)
