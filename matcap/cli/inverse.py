"""`matcap inverse`: train the network that reads a photograph's own maps, and ship it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from matcap.cli.laboratory import require_laboratory
from matcap.cli.options import QuietOption, typed
from matcap.files import values

app = typer.Typer(
    help="Train the network that reads a photograph's own maps.", no_args_is_help=True
)

TrainingArgument = Annotated[
    Path, typer.Argument(metavar="FOLDER", help="Where training is kept; made when missing.")
]


@app.callback()
def _inverse() -> None:
    """Train the network that reads a photograph's own maps."""
    require_laboratory()


@app.command()
def train(
    folder: TrainingArgument,
    steps: Annotated[
        int, typer.Option(min=1, help="To have done in all at the end of this leg.")
    ] = 1_000_000,
    time_limit: Annotated[
        float | None,
        typer.Option(
            "--time", parser=typed(values.duration), metavar="TIME", help="Of this leg: 25m."
        ),
    ] = None,
    rate: Annotated[float, typer.Option(help="Adam's rate.")] = 4e-4,
    cooling: Annotated[
        int, typer.Option(min=0, help="Steps before the last over which the rate falls to nothing.")
    ] = 0,
    batch: Annotated[int, typer.Option(min=1, help="Photographs a step.")] = 1,
    workers: Annotated[
        int, typer.Option(min=0, help="Processes that make photographs; 0 for none.")
    ] = 1,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    quiet: QuietOption = False,
) -> None:
    """Train one leg on endless simulated photographs; legs continue one another exactly."""
    from matcap.lab.inverse.train import TrainSettings
    from matcap.lab.inverse.train import train as run

    settings = TrainSettings(
        steps=steps, seconds=time_limit or float("inf"), rate=rate, cooling=cooling,
        batch=batch, workers=workers, device=device,
    )  # fmt: skip
    run(folder, settings, tell=(lambda _line: None) if quiet else _tell)


@app.command()
def ship(
    folder: TrainingArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="The network's file.")] = Path(
        "inverse.safetensors"
    ),
    quiet: QuietOption = False,
) -> None:
    """Write a training's running average as the file that captures read, in half precision."""
    from matcap.lab.inverse.train import ship as run

    card = run(folder, out)
    if not quiet:
        typer.echo(f"wrote {out}: {card['steps']} steps", err=True)


def _tell(line: str) -> None:
    typer.echo(line, err=True)
