"""`matcap compare`: two captures side by side."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from matcap.cli.options import JsonOption, OverwriteOption, QuietOption, printer
from matcap.errors import UsageError

if TYPE_CHECKING:
    from matcap.capture.compare import Compared


def compare(
    first: Annotated[
        Path, typer.Argument(metavar="A", help="A capture's folder, or its .matcap file.")
    ],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another capture.")],
    photo: Annotated[
        list[Path] | None,
        typer.Option(
            show_default="the captured ones",
            help="A photograph to show with both; given twice, with A and with B.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="The picture, a PNG.")] = Path(
        "compared.png"
    ),
    overwrite: OverwriteOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Show two captures, or two versions of one, under the same lights, with their verdicts."""
    from matcap.capture.compare import Compared, comparison
    from matcap.files.names import check_suffix
    from matcap.files.output import Output, check_output, check_writable
    from matcap.photo.load import load_photo

    photos = list(photo or [])
    if len(photos) > 2:
        raise UsageError.at("--photo", "there are more than two", "give one or two")
    check_suffix(out, (".png",), "picture")
    inputs = [file for file in (first, second, *photos) if not file.is_dir()]
    check_output([out], inputs=inputs, overwrite=overwrite)
    check_writable(out.parent, 10_000_000, [out.name])
    captures = [Compared.open(path) for path in (first, second)]
    given = photos * 2 if len(photos) == 1 else photos
    shown: Sequence[Path | None] = given or [_own(one, quiet=quiet) for one in captures]
    read = [file for file in shown if file is not None]
    check_output([out], inputs=read, overwrite=overwrite)
    loaded = partial(load_photo, long_side=1024, noise=False)
    pictures = [None if file is None else loaded(file) for file in shown]
    sheet = comparison(captures, pictures)
    with Output.file(out) as file:
        sheet.save(file, "PNG")
    if as_json:
        entries = [{"name": one.name, "verdict": one.verdict} for one in captures]
        typer.echo(json.dumps({"picture": str(out), "captures": entries}, indent=2))
    elif not quiet:
        for one in captures:
            typer.echo(one.title(), err=True)
        typer.echo(f"wrote {out}", err=True)


def _own(capture: Compared, *, quiet: bool) -> Path | None:
    """The photograph of a capture; None if unknown or the file no longer exists."""
    file = capture.photograph
    if file is None or file.is_file():
        return file
    said = f"{capture.name}: its photograph {file} does not exist; give it with --photo."
    printer(quiet=quiet)(said)
    return None
