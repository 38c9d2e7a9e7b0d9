"""`matcap sample`: a sheet of materials drawn from the prior."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from matcap.cli.options import QuietOption


def sample(
    count: Annotated[int, typer.Option("-n", min=1, max=256, help="How many.")] = 16,
    seed: Annotated[int, typer.Option(min=0, help="Of the first; the others follow.")] = 0,
    prior: Annotated[
        Path | None, typer.Option(help="A prior's file, instead of the one that comes along.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="The picture, .png or .exr.")] = Path(
        "samples.png"
    ),
    quiet: QuietOption = False,
) -> None:
    """Draw materials out of nothing and show them under a flash."""
    from matcap.capture.prior.sample import sample_sheet
    from matcap.capture.prior.store import load_prior
    from matcap.files.picture import check_picture_path, write_picture

    check_picture_path(out)
    write_picture(sample_sheet(load_prior(prior), count, seed), out)
    if not quiet:
        typer.echo(f"wrote {out}", err=True)
