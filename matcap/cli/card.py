"""`matcap card`: a calibration card to print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from matcap.cli.options import QuietOption


def card(
    out: Annotated[Path, typer.Option("--out", "-o", help="The page, .pdf or .svg.")] = Path(
        "card.pdf"
    ),
    quiet: QuietOption = False,
) -> None:
    """Write a card to print: a board that measures millimetres and tilt, and patches of colour.

    Lay it flat, photograph it as the samples are, and put the photograph into the folder as
    card.dng or card.jpg: matcap batch finds it. Colours need a real ColorChecker; print shifts
    them.
    """
    from matcap.photo.card import write_card

    write_card(out)
    if not quiet:
        typer.echo(f"wrote {out}; print it at 100 %", err=True)
