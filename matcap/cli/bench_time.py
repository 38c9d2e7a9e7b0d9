"""`matcap bench capture` and `matcap bench report`: what accuracy costs in time."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

_OUT = Path("bench/capture")


def capture(
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder of photographs, materials and capture.csv.")
    ] = _OUT,
    point: Annotated[
        list[str] | None,
        typer.Option(help="Only this way of capturing; may be given several times. See --list."),
    ] = None,
    material: Annotated[
        list[str] | None, typer.Option(help="Only this subject; may be given several times.")
    ] = None,
    seed: Annotated[
        list[int] | None, typer.Option(help="Of the captures; may be given several times. 0.")
    ] = None,
    detail: Annotated[
        int, typer.Option(min=128, max=4096, help="Texels along the photograph's long side.")
    ] = 1024,
    size: Annotated[
        int, typer.Option(min=192, max=1024, help="Texels a side of the pictures compared.")
    ] = 384,
    steps: Annotated[
        int | None, typer.Option(min=0, help="Instead of each point's own: to try a sweep out.")
    ] = None,
    step: Annotated[
        bool, typer.Option("--step", help="Time single steps beside the paper's form instead.")
    ] = False,
    show: Annotated[
        bool, typer.Option("--list", help="Print points and subjects, and end.")
    ] = False,
) -> None:
    """Error, seconds and memory of captures, over presets, steps, windows, statistics and more.

    Appends a line to capture.csv as soon as it is measured, and skips what is there: stop it and
    start it again as you like. Times mean something on a quiet machine only.
    """
    from matcap.files.staging import check_writable
    from matcap.lab.bench.capture import (
        SUBJECTS,
        USUAL,
        USUAL_SUBJECTS,
        WAYS,
        CaptureBench,
        run_capture_bench,
        run_steps,
    )
    from matcap.lab.bench.quality import QualitySettings

    if show:
        for name, way in WAYS.items():
            typer.echo(f"point    {way.group:10} {name}{'' if name in USUAL else ' (on demand)'}")
        for name in SUBJECTS:
            typer.echo(f"subject  {name}{'' if name in USUAL_SUBJECTS else ' (on demand)'}")
        return
    check_writable(out, 500_000_000)

    def tell(line: str) -> None:
        typer.echo(line, err=True)

    bench = CaptureBench(
        out,
        point or USUAL,
        material or (),
        seed or (0,),
        QualitySettings(detail=detail, size=size),
        steps,
    )
    measured = run_steps(bench, tell) if step else run_capture_bench(bench, tell)
    typer.echo(f"{bench.table}: {len(measured)} measurements")


def report(
    tables: Annotated[
        list[Path],
        typer.Argument(metavar="TABLE...", help="CSVs of benches; JSON of bench relight --json."),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="The page; a picture goes beside every CSV.")
    ] = Path("docs/notes/accuracy-and-time.md"),
) -> None:
    """Write the page on accuracy and time from what was measured."""
    from matcap.lab.bench.report import write_report

    write_report(tables, out, ["matcap", *sys.argv[1:]])
    typer.echo(str(out))
