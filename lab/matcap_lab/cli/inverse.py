"""`matcap-lab inverse`: train and write the network that predicts a photograph's maps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from matcap.cli.options import QuietOption, printer, typed
from matcap.files import settings as values

app = typer.Typer(
    help="Train the network that predicts maps from a photograph.", no_args_is_help=True
)

TrainingArgument = Annotated[
    Path, typer.Argument(metavar="FOLDER", help="Folder of the training; created if missing.")
]


@app.command()
def train(
    folder: TrainingArgument,
    steps: Annotated[
        int, typer.Option(min=1, help="Total number of steps at which training ends.")
    ] = 1_000_000,
    time_limit: Annotated[
        float | None,
        typer.Option(
            "--time",
            parser=typed(values.duration),
            metavar="TIME",
            help="Time limit of this run, such as 25m.",
        ),
    ] = None,
    rate: Annotated[float, typer.Option(help="Learning rate of Adam.")] = 4e-4,
    cooling: Annotated[
        int,
        typer.Option(min=0, help="Number of last steps, over which the learning rate falls to 0."),
    ] = 0,
    batch: Annotated[int, typer.Option(min=1, help="Photographs per step.")] = 1,
    size: Annotated[
        tuple[int, int], typer.Option(help="Width and height of a photograph, multiples of 32.")
    ] = (224, 160),
    compiled: Annotated[
        bool, typer.Option(help="Compile the losses: takes minutes, then steps are faster.")
    ] = False,
    workers: Annotated[
        int, typer.Option(min=0, help="Processes that simulate photographs; 0: this one does.")
    ] = 1,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    maps: Annotated[
        Path | None, typer.Option(help="Real map sets (`inverse pack`), besides simulated ones.")
    ] = None,
    real: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of photographs of real materials.")
    ] = 0.5,
    begin: Annotated[
        Path | None, typer.Option("--from", help="A network's file from which training starts.")
    ] = None,
    quiet: QuietOption = False,
) -> None:
    """Train on endless simulated photographs; a later run continues exactly."""
    from matcap_lab.inverse.train import TrainSettings
    from matcap_lab.inverse.train import train as run

    settings = TrainSettings(
        steps=steps, seconds=time_limit or float("inf"), rate=rate, cooling=cooling,
        batch=batch, workers=workers, device=device, maps=maps,
        width=size[0], height=size[1], compiled=compiled, real=real,
    )  # fmt: skip
    run(folder, settings, on_progress=printer(quiet=quiet), begin=begin)


@app.command()
def pack(
    folder: Annotated[
        Path, typer.Argument(help="Folders with basecolor, normal, roughness and metallic.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="The packed file.")] = Path("maps.pack"),
    quiet: QuietOption = False,
) -> None:
    """Pack map sets of real materials into one file for training."""
    from matcap_lab.inverse.samples import pack as run

    count = run(folder, out)
    printer(quiet=quiet)(f"wrote {out}: {count} materials")


@app.command()
def evaluate(
    networks: Annotated[
        list[Path], typer.Argument(help="Files of networks, or folders of trainings.")
    ],
    maps: Annotated[Path, typer.Option(help="Real map sets (`inverse pack`).")],
) -> None:
    """Evaluate networks on held-out real map sets and simulated materials."""
    from matcap_lab.inverse import evaluate as judge
    from matcap_lab.inverse.samples import held_out_sets
    from matcap_lab.inverse.train import read_network

    real, simulated = judge.real_samples(held_out_sets(maps)), judge.simulated_samples()
    results = {}
    for path in networks:
        network = read_network(path)
        results[f"{path.stem}, real"] = judge.evaluate(network, real)
        results[f"{path.stem}, simulated"] = judge.evaluate(network, simulated)
    typer.echo(judge.table(results))


@app.command()
def ship(
    folder: TrainingArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="The network's file.")] = Path(
        "inverse.safetensors"
    ),
    quiet: QuietOption = False,
) -> None:
    """Write a training's averaged weights in half precision, as captures read them."""
    from matcap_lab.inverse.train import ship as run

    card = run(folder, out)
    printer(quiet=quiet)(f"wrote {out}: {card['steps']} steps")
