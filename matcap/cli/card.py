"""`matcap card`: a calibration card to print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from matcap.cli.options import QuietOption, printer


def card(
    out: Annotated[Path, typer.Option("--out", "-o", help="The page, .pdf or .svg.")] = Path(
        "card.pdf"
    ),
    quiet: QuietOption = False,
) -> None:
    """Write a calibration card to print: a board for scale and tilt, and colour patches.

    Lay it flat, photograph it in the same way as the samples, and name the photograph card.dng or
    card.jpg in their folder, where matcap batch reads it. Printing changes colours: calibrate them
    with a real ColorChecker.
    """
    from matcap.photo.card import write_card

    write_card(out)
    printer(quiet=quiet)(f"wrote {out}; print it at 100 %")
