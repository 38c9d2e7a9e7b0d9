"""`matcap-lab prior`: build a corpus, train a space of materials on it, and measure it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from matcap.cli.options import QuietOption, printer

app = typer.Typer(
    help="Train and measure the prior, a latent space of materials.", no_args_is_help=True
)

PackArgument = Annotated[Path, typer.Argument(metavar="PACK", help="File made by `prior corpus`.")]
PriorOption = Annotated[
    Path | None, typer.Option(help="A prior's file, instead of the included one.")
]
ResultsOption = Annotated[
    Path, typer.Option("--out", "-o", help="Folder for the table, the picture and single results.")
]


@app.command()
def corpus(
    folder: Annotated[
        Path | None,
        typer.Argument(metavar="FOLDER", help="Folder of photographs named MATERIAL_*.jpg."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="The pack.")] = Path("corpus.pack"),
    simulated: Annotated[int, typer.Option(min=0, help="Simulated photographs to add.")] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of simulated photographs.")] = 0,
    quiet: QuietOption = False,
) -> None:
    """Pack photographs for training; unreadable ones are left out and listed."""
    from matcap.files.output import check_writable
    from matcap_lab.train.corpus import build

    check_writable(out.parent, 50_000_000)
    pack, skipped = build(folder, simulated, seed, printer(quiet=quiet))
    pack.save(out)
    for name, why in skipped:
        typer.echo(f"left out {name}: {why}", err=True)
    size = out.stat().st_size / 1e6
    printer(quiet=quiet)(f"wrote {out}: {len(pack.entries)} photographs, {size:.1f} MB")


@app.command()
def train(
    pack: PackArgument,
    config: Annotated[Path, typer.Option(help="TOML; see docs/guide/train-a-prior.md.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for checkpoints and curves.")],
    resume: Annotated[bool, typer.Option("--resume", help="Continue from the checkpoint.")] = False,
    begin: Annotated[
        Path | None, typer.Option("--start", help="A prior from whose networks training starts.")
    ] = None,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    quiet: QuietOption = False,
) -> None:
    """Train encoder and decoder on a pack; --resume continues an interrupted run."""
    from matcap.space.prior.store import load_prior
    from matcap_lab.train.corpus import Pack
    from matcap_lab.train.training import read_config
    from matcap_lab.train.training import train as run

    run(
        Pack.load(pack),
        read_config(config),
        out,
        resume=resume,
        prior=load_prior(begin) if begin is not None else None,
        device=device,
        on_progress=printer(quiet=quiet),
    )


@app.command()
def finish(
    pack: PackArgument,
    config: Annotated[Path, typer.Option(help="The TOML it was trained with.")],
    training: Annotated[Path, typer.Option(help="Folder that `prior train` wrote to.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The prior.")],
    quiet: QuietOption = False,
) -> None:
    """Make a prior of a finished training."""
    from matcap_lab.train.corpus import Pack
    from matcap_lab.train.finish import finish as run
    from matcap_lab.train.step import start
    from matcap_lab.train.training import read_config

    state = start(read_config(config), "cpu")
    state.load(training)
    kept = state.average
    run(kept.encoder, kept.decoder, Pack.load(pack).training, {"steps": state.step}).save(out)
    printer(quiet=quiet)(f"wrote {out}")


@app.command()
def align(
    out: Annotated[Path, typer.Option("--out", "-o", help="The branch.")],
    materials: Annotated[
        int, typer.Option(min=16, help="Simulated materials, each photographed eight times.")
    ] = 1250,
    steps: Annotated[int, typer.Option(min=1, help="Training steps, of 24 photographs.")] = 8000,
    start: Annotated[
        Path | None, typer.Option(help="A branch to train on, at a lower rate.")
    ] = None,
    quiet: QuietOption = False,
) -> None:
    """Train the alignment branch, which predicts a photograph's tilt, on simulated ones."""
    from matcap.files.output import check_writable
    from matcap.flash.alignment import load_alignment, save_alignment
    from matcap_lab.train.alignment import report_alignment, train_branch

    check_writable(out.parent, 2_000_000)
    begun = None if start is None else load_alignment(start)
    branch = train_branch(materials, steps, start=begun, on_progress=printer(quiet=quiet))
    save_alignment(out, branch)
    typer.echo(report_alignment(branch))


@app.command()
def anchors(
    pack: PackArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="The prior.")],
    prior: PriorOption = None,
    quiet: QuietOption = False,
) -> None:
    """Store latent vectors of a pack's training photographs, near which the prior draws.

    The networks are unchanged. `prior finish` includes this.
    """
    from matcap.space.prior.store import load_prior
    from matcap_lab.train.corpus import Pack
    from matcap_lab.train.finish import with_anchors

    with_anchors(load_prior(prior), Pack.load(pack).training).save(out)
    printer(quiet=quiet)(f"wrote {out}")


@app.command()
def evaluate(
    pack: PackArgument,
    prior: PriorOption = None,
    out: ResultsOption = Path("bench/prior"),
    steps: Annotated[int, typer.Option(min=1, help="Fine-tuning steps from the prior.")] = 100,
    longer: Annotated[
        int, typer.Option(min=1, help="Fine-tuning steps from random weights.")
    ] = 1000,
    materials: Annotated[int, typer.Option(min=1, help="Number of held-out materials.")] = 12,
    quiet: QuietOption = False,
) -> None:
    """Measure a prior on held-out photographs and unseen simulated materials.

    Each result is appended to prior-evaluation.csv; the same command resumes from it. Rows are
    identified by material, prior and options, not by the version of matcap: after changing that, or
    the pack, remove the CSV.
    """
    from matcap.space.prior.store import load_prior
    from matcap_lab.experiment.results import command_line
    from matcap_lab.train.corpus import Pack
    from matcap_lab.train.evaluate import EvaluateSettings, run_evaluation

    settings = EvaluateSettings(steps, longer, materials)
    given = load_prior(prior), Pack.load(pack), settings, out, command_line(), printer(quiet=quiet)
    typer.echo(run_evaluation(*given))


@app.command()
def variety(
    pack: PackArgument,
    prior: PriorOption = None,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for the table and the picture.")
    ] = Path("bench/prior"),
    draws: Annotated[int, typer.Option(min=8, help="Number of materials to draw.")] = 256,
    simulated: Annotated[
        int,
        typer.Option(min=8, help="Simulated photographs to compare with, besides held-out ones."),
    ] = 64,
    quiet: QuietOption = False,
) -> None:
    """Measure the diversity of a prior's draws and their likeness to held-out photographs.

    Precision, recall and pairwise style distance, and a sheet of draws.
    """
    from matcap.files.output import check_writable
    from matcap.space.prior.store import load_prior
    from matcap_lab.experiment.results import command_line
    from matcap_lab.train.corpus import Pack
    from matcap_lab.train.evaluate import VarietySettings, run_variety

    check_writable(out, 2_000_000)
    settings = VarietySettings(draws, simulated)
    page = run_variety(
        load_prior(prior), Pack.load(pack), settings, out, command_line(), printer(quiet=quiet)
    )
    typer.echo(page)
