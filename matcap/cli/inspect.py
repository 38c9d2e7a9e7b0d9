"""`matcap inspect`: what to do better at the next shot."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from matcap.cli.options import JsonOption
from matcap.errors import ExitCode, MatcapError, UsageError

if TYPE_CHECKING:
    from matcap.capture.prior.store import Prior
    from matcap.photo.inspect import Inspection

_MARKS = {"good": "ok", "note": "  ", "doubtful": "? ", "poor": "! "}


def inspect(
    photos: Annotated[
        list[Path], typer.Argument(metavar="PHOTO...", help="RAW (DNG, ...), JPEG, PNG or TIFF.")
    ],
    detail: Annotated[
        int, typer.Option(min=64, max=8192, help="Pixels across that a capture would look at.")
    ] = 1024,
    fov: Annotated[
        float | None,
        typer.Option(min=1.0, max=170.0, help="Field of view along the long side, degrees."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Say how good photographs are, and what to do at the next shot.

    Flash, clipping, hot spot, tilt, sharpness, sameness all over, and what kind of file it is.
    Lines marked "!" hurt, "?" may hurt.
    """
    from matcap.capture.prior.store import load_prior

    prior = load_prior()
    documents: list[dict[str, Any]] = []
    failures = 0
    for path in photos:
        try:
            found = _inspected(path, detail, fov, prior)
        except UsageError:
            raise
        except MatcapError as error:
            failures += 1
            documents.append({"photo": str(path), "reason": str(error)})
            typer.echo(f"matcap: {error}", err=True)
            continue
        documents.append({"photo": str(path), **found.document()})
        if not as_json:
            typer.echo(_text(path, found))
    if as_json:
        typer.echo(json.dumps({"photographs": documents}, indent=2, allow_nan=False))
    if failures:
        some = failures < len(photos)
        raise typer.Exit(ExitCode.SOME_FAILED if some else ExitCode.NOTHING_SUCCEEDED)


def _inspected(path: Path, detail: int, fov: float | None, prior: Prior) -> Inspection:
    from matcap.photo.inspect import inspect_photo
    from matcap.photo.load import load_photo

    photo = load_photo(path, long_side=detail, fov=fov, noise=False)
    return inspect_photo(photo, prior.tilt(photo))


def _text(path: Path, found: Inspection) -> str:
    lines = [f"{path}: {found.verdict.value}"]
    lines += [f"  {_MARKS[f.verdict.value]} {f.name:<13} {f.line()}" for f in found.findings]
    return "\n".join(lines)
