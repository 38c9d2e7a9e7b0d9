"""`matcap bench fronts`, `pairs` and `report`: what accuracy costs in time."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

_OUT = Path("bench/fronts")


def fronts(
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder of photographs, sheets and fronts.csv.")
    ] = _OUT,
    sets: Annotated[
        Path | None,
        typer.Option(help="Folder of artists' map sets, of which six held out ones are taken."),
    ] = None,
    point: Annotated[
        list[str] | None,
        typer.Option(help="Only this way of capturing; may be given several times. See --list."),
    ] = None,
    material: Annotated[
        list[str] | None,
        typer.Option(help="Only this one, of names, kinds or sets; may be given several times."),
    ] = None,
    seed: Annotated[
        list[int] | None, typer.Option(help="Of the captures; may be given several times. 0.")
    ] = None,
    show: Annotated[
        bool, typer.Option("--list", help="Print points and materials, and end.")
    ] = False,
) -> None:
    """Error, seconds and memory of captures, over work, photographs, detail, time and generators.

    Photographs materials whose truth is known as real ones are photographed, runs `matcap capture`
    on them and compares what it wrote with other true pieces. Appends a line to fronts.csv as soon
    as it is measured, and skips what is there: stop it and start it again as you like. Seconds by
    the clock mean something on a quiet machine only.
    """
    from matcap.files.staging import check_writable
    from matcap.lab.bench.fronts import Fronts, run_fronts
    from matcap.lab.bench.ways import USUAL, WAYS

    bench = Fronts(out, sets, point or USUAL, material or (), seed or (0,))
    if show:
        for name, way in WAYS.items():
            typer.echo(f"point    {way.group:15} {name}{'' if name in USUAL else ' (on demand)'}")
        for name in bench.chosen:
            typer.echo(f"material {name}")
        return
    check_writable(out, 500_000_000)
    measured = run_fronts(bench, lambda line: typer.echo(line, err=True))
    typer.echo(f"{bench.table}: {len(measured)} measurements")


def pairs(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="That bench fronts wrote.")
    ] = _OUT,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for pages of pairs and pairs.csv.")
    ] = Path("bench/pairs"),
    count: Annotated[int, typer.Option("-n", min=1, help="How many.")] = 40,
    seed: Annotated[int, typer.Option(min=0, help="Of which ones, and of their sides.")] = 0,
) -> None:
    """Captures of the fronts side by side, without names, the truth between them.

    Look at the pages, write left, right or neither into the column `nearer` of pairs.csv, and put
    it beside fronts.csv: bench report tells how often each measure agrees.
    """
    from matcap.lab.bench.pairs import write_pairs

    typer.echo(str(write_pairs(folder, out, count, seed)))


def report(
    tables: Annotated[
        list[Path],
        typer.Argument(
            metavar="TABLE...", help="CSV of bench fronts; JSON of bench relight --json."
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="The page; a picture goes beside every CSV.")
    ] = Path("docs/notes/accuracy-and-time.md"),
) -> None:
    """Write the page on accuracy and time from what was measured.

    What stands under its last heading is written by hand, and kept.
    """
    from matcap.lab.bench.report import write_report

    write_report(tables, out, ["matcap", *sys.argv[1:]])
    typer.echo(str(out))
