"""`matcap-lab bench`: experiments that measure what the documentation claims, a command each.

Each writes a CSV row by row, resumes from it, and prints it as a table (matcap_lab/experiment).
This module turns options into an experiment's subjects and configurations.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from matcap.capture.settings import CaptureSettings
from matcap.cli.options import NOTHING, Fields, Given, JsonOption, printer, typed, with_settings
from matcap.errors import UsageError
from matcap.files import settings as values

if TYPE_CHECKING:
    from matcap_lab.experiment.results import Trial
    from matcap_lab.experiment.runner import Experiment

app = typer.Typer(help="Measure matcap on this machine.", no_args_is_help=True)

MaterialArgument = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[MATERIAL]...",
        help="Simulated materials, kinds (weave; weave:7 is another draw) or map sets.",
    ),
]
OnlyOption = Annotated[
    list[str] | None, typer.Option(help="Measure only what is named; may be repeated.")
]
SetsOption = Annotated[
    Path | None, typer.Option(help="Folder of artists' map sets; all of them if none is named.")
]
OutOption = Annotated[
    Path, typer.Option("--out", "-o", help="Folder for the table and the captures measured.")
]

# Periods, texels, and angles, degrees, of the gratings of `bench fields --phases`.
_LATTICES = (
    (2.5, 0.0),
    (4.3, 7.0),
    (8.0, 45.0),
    (17.3, 21.0),
    (60.0, 33.0),
    (120.0, 3.0),
    (300.0, 0.0),
)


@app.command()
@with_settings
def floors(
    material: MaterialArgument = None,
    sets: SetsOption = None,
    out: OutOption = Path("bench/floors"),
    given: Annotated[
        Given, Fields(CaptureSettings, only=("preset", "detail", "generator"))
    ] = NOTHING,
    judged: Annotated[
        int,
        typer.Option(
            min=256, max=4096, help="Texels along the long side at which pictures are compared."
        ),
    ] = 512,
    stops: Annotated[
        float, typer.Option(min=-8.0, max=8.0, help="Exposure offset (EV) from the camera's own.")
    ] = 0.0,
    jpeg: Annotated[bool, typer.Option("--jpeg", help="Simulate JPEGs instead of RAW.")] = False,
    photographs: Annotated[
        list[int] | None,
        typer.Option(
            min=1, max=12, help="Photographs per sample, from different places; may be repeated."
        ),
    ] = None,
    pixels: Annotated[
        int, typer.Option(min=320, max=8192, help="Width of the photographs, which are 4:3.")
    ] = 1600,
    room: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=10.0,
            help="With --photographs: irradiance of ambient light, for a flash of 1 in plane "
            "units; each count is captured without and with one more photograph without flash.",
        ),
    ] = 0.0,
    union: Annotated[
        bool,
        typer.Option(
            "--union",
            help="With --photographs: the phone is moved by half a picture each time, and each "
            "count is also captured with --union.",
        ),
    ] = False,
) -> None:
    """Style distance of captures to the truth, by a measure to which nothing is tuned.

    Photographs known materials, captures them, and compares photograph, exemplar and field with
    other true samples under new lights: normalised style distance by SqueezeNet, 1 is
    indistinguishable. Prints the table, with statistics of the maps and of the truth.
    """
    from matcap_lab.bench import floors as of
    from matcap_lab.measures.evaluator import EvaluationSettings
    from matcap_lab.simulate.hand_held import Hand, downward
    from matcap_lab.simulate.photograph import PhoneCamera
    from matcap_lab.simulate.specimen import subjects

    camera = PhoneCamera(width=pixels, height=3 * pixels // 8 * 2)
    evaluation = EvaluationSettings(judged, judged // 2, camera)
    settings = of.PhotographSettings(
        CaptureSettings(**{"generator": "example", **given}), stops, jpeg
    )
    chosen = subjects(material or (), sets)
    if not photographs:
        _print(of.nsd_experiment(chosen, out, settings, evaluation), out, of.FLOORS)
        return
    ambient = of.Ambient(room, union, downward(camera) if union else Hand())
    experiment = of.several_experiment(chosen, photographs, out, settings, evaluation, ambient)
    rows = _print(experiment, out, of.SEVERAL)
    _draw(rows, out / "photographs.png", "Error by number of photographs of one sample")


@app.command()
def metals(
    material: MaterialArgument = None,
    sets: SetsOption = None,
    out: OutOption = Path("bench/metals"),
    known: Annotated[
        bool,
        typer.Option("--known-flash", help="Give captures the flash's intensity, as a card does."),
    ] = False,
) -> None:
    """Errors of F0 of metals, by channel and in hue, and of dielectric parts.

    Photographs known metals, captures them, and compares F0 where the truth is metal and where it
    is dielectric, texel by texel. Prints the table.
    """
    from matcap_lab.bench.reflectance import METALS, metals_experiment
    from matcap_lab.simulate.kinds.metals_and_coats import SHEETS
    from matcap_lab.simulate.photograph import PhoneCamera
    from matcap_lab.simulate.specimen import subjects

    chosen = subjects(material or tuple(SHEETS), sets)
    settings = CaptureSettings("instant", detail=512, generator="example")
    _print(metals_experiment(chosen, out, settings, PhoneCamera(), known=known), out, METALS)


@app.command()
def fields(
    material: MaterialArgument = None,
    sets: SetsOption = None,
    phases: Annotated[
        bool, typer.Option("--phases", help="Also measure rotated lattices of 2.5 to 300 texels.")
    ] = False,
    out: OutOption = Path("bench/fields"),
) -> None:
    """Errors of fields and periodic tiles synthesised from true maps.

    The exemplar is the truth, so that only synthesis is measured: by normalised style distance as
    in `bench floors`, by the length of joints relative to the truth's, and by the phase error of a
    lattice 16384 texels away. Prints the table.
    """
    from matcap_lab.bench.fields import FIELDS, fields_experiment, grating, phase_off
    from matcap_lab.simulate.specimen import subjects

    _print(fields_experiment(subjects(material or (), sets)), out, FIELDS)
    for period, angle in _LATTICES if phases else ():
        off = phase_off(grating(period, angle, (1280, 960)))
        text = "no lattice" if off is None else f"{off:.4f} of a turn off"
        typer.echo(f"period {period:g} at {angle:g} degrees: {text}")


@app.command()
def gloss(
    slope: Annotated[
        list[float] | None,
        typer.Option(min=0.0, max=1.0, help="Slope of bumps; may be repeated; default 0."),
    ] = None,
    stops: Annotated[
        list[int] | None,
        typer.Option(min=-3, max=6, help="Exposure offset (EV); may be repeated; default 0 to 3."),
    ] = None,
    out: OutOption = Path("bench/gloss"),
) -> None:
    """Estimates of roughness and F0 of plain materials, polished to matte, over exposures.

    Prints the table, a row for each material and exposure.
    """
    from matcap_lab.bench.reflectance import GLOSS, gloss_experiment, materials

    _print(gloss_experiment(materials(slope or (0.0,)), stops or (0, 1, 2, 3)), out, GLOSS)


@app.command()
def repetition(
    materials: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MATERIAL]...",
            help="Simulated materials by name, or .matcap files; six simulated ones by default.",
        ),
    ] = None,
    size: Annotated[int, typer.Option(min=512, max=8192, help="Texels per side.")] = 4096,
    out: OutOption = Path("bench/repetition"),
) -> None:
    """Repetition in fields by example.

    Autocorrelation and cross-correlation of two seeds, sizes of verbatim copies, and difference of
    two seeds. Prints the table.
    """
    from matcap_lab.bench.fields import REPETITION, repetition_experiment

    _print(repetition_experiment(materials or (), size), out, REPETITION)


@app.command()
def fronts(
    out: OutOption = Path("bench/fronts"),
    sets: Annotated[
        Path | None, typer.Option(help="Folder of artists' map sets; six held-out ones are used.")
    ] = None,
    point: OnlyOption = None,
    material: OnlyOption = None,
    seed: Annotated[
        list[int] | None, typer.Option(help="Seed of captures; may be repeated; default 0.")
    ] = None,
    show: Annotated[
        bool, typer.Option("--list", help="Print points and materials, and exit.")
    ] = False,
) -> None:
    """Error, seconds and memory of captures, over work, photographs, detail and generators.

    Simulates phone photographs of materials with known truth, runs `matcap capture` on them and
    compares its output with other true samples. Rows measured by another version of matcap are
    kept. Wall times are meaningful only on an otherwise idle machine.
    """
    from matcap_lab.bench.fronts import USUAL, WAYS, Fronts, fronts_experiment

    bench = Fronts(out, sets, point or USUAL, material or (), tuple(seed or (0,)))
    if show:
        for name, way in WAYS.items():
            typer.echo(f"point    {way.group:15} {name}{'' if name in USUAL else ' (on demand)'}")
        for name in bench.chosen:
            typer.echo(f"material {name}")
        return
    rows = _measured(fronts_experiment(bench), out)
    typer.echo(f"{out / 'fronts.csv'}: {len(rows)} measurements")


@app.command()
def relight(
    scenes: Annotated[
        list[Path] | None,
        typer.Argument(help="Scene files or names; default: studio, sunset, turntable."),
    ] = None,
    json: JsonOption = False,
    tolerances: Annotated[
        bool, typer.Option("--tolerances", help="Measure time against accuracy, by tolerance.")
    ] = False,
    out: OutOption = Path("bench/relight"),
    width: Annotated[
        int, typer.Option(min=16, max=4096, help="Width of the pictures of --tolerances.")
    ] = 256,
) -> None:
    """Time of relighting, and time saved by leaving effects out.

    One megapixel under one light; each scene with the effects that the renderer chooses, with all
    effects, and a second picture of the same surface. With --tolerances each scene at several
    tolerances, with all effects and with diffuse light alone: seconds against the largest error, as
    a table and a plot.
    """
    from matcap_lab.bench import relight as bench

    if tolerances:
        experiment = bench.tolerance_experiment(scenes or (), width=width)
        about = bench.TOLERANCE
        rows = _print(experiment, out, about.about, json=json)
        _draw(rows, out / "tolerances.png", about.title, about.axes, about.least)
    else:
        _print(bench.plan_experiment(scenes or ()), out, bench.PLAN.about, json=json)


@app.command()
def synth(
    out: OutOption = Path("bench/synth"),
    size: Annotated[
        values.Size,
        typer.Option(
            parser=typed(values.size),
            metavar="WxH",
            show_default="4096x256",
            help="Size of the map.",
        ),
    ] = values.Size(4096, 256),  # noqa: B008
    network: Annotated[
        list[str] | None, typer.Option(help="shipped or paper; default: both.")
    ] = None,
    block: Annotated[
        list[str] | None, typer.Option(metavar="WxH", help="Block of the field; may be repeated.")
    ] = None,
    workers: Annotated[
        list[int] | None, typer.Option("--workers", "-j", min=1, help="Threads; default: 1 and 2.")
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Repetitions; the median counts.")] = 3,
) -> None:
    """Speed of synthesis, and of the paper's form of the same network.

    Prints the table. The paper's network takes a few gigabytes.
    """
    from matcap.space.decoder import ALIGNMENT
    from matcap_lab.bench.synth import ABOUT, BLOCKS, NETWORKS, SynthSettings, synth_experiment

    for name in network or ():
        if name not in NETWORKS:
            raise UsageError.at(name, "there is no such network", f"use {' or '.join(NETWORKS)}")
    blocks = [typed(values.size)(one) for one in block or BLOCKS]
    for side in (side for one in (size, *blocks) for side in one):
        if side % ALIGNMENT:
            raise UsageError(
                f"{side} is not a multiple of {ALIGNMENT}", remedy="round the sizes to multiples"
            )
    settings = SynthSettings(
        size,
        tuple(network or NETWORKS),
        tuple(str(one) for one in blocks),
        tuple(workers or (1, 2)),
        repeats,
    )
    _print(synth_experiment(settings), out, ABOUT)


@app.command()
def profile(
    photographs: Annotated[
        list[Path], typer.Argument(metavar="PHOTO...", help="Photographs, each captured alone.")
    ],
    preset: Annotated[
        list[str] | None, typer.Option(help="Only this preset; may be repeated.")
    ] = None,
    out: OutOption = Path("bench/profile"),
) -> None:
    """Processor time, wall time and peak memory of captures, by preset and stage.

    Captures each photograph by each preset in a process of its own. Prints the table.
    """
    from matcap_lab.bench.profile import ABOUT, profile_experiment

    _print(profile_experiment(photographs, preset or ()), out, ABOUT)


@app.command()
def report(
    tables: Annotated[
        list[Path],
        typer.Argument(metavar="TABLE...", help="CSVs of bench fronts and bench relight."),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="The page; a plot is written next to each CSV.")
    ] = Path("docs/notes/accuracy-and-time.md"),
) -> None:
    """Write the page on accuracy and time from the tables.

    Text under the existing page's last heading is kept.
    """
    from matcap_lab.bench.fronts import presentation_of
    from matcap_lab.experiment.page import write_page
    from matcap_lab.experiment.results import command_line

    write_page({table: presentation_of(table) for table in tables}, out, command_line())
    typer.echo(str(out))


@app.command()
def paper(
    sets: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of artists' map sets.")],
    out: OutOption = Path("bench/paper"),
    material: OnlyOption = None,
    configuration: OnlyOption = None,
    steps: Annotated[
        int | None, typer.Option(min=1, help="Steps of fine-tuning; default: those of `standard`.")
    ] = None,
    vgg16: Annotated[
        Path | None, typer.Option(help="VGG-16 weights (safetensors), for the VGG-16 columns.")
    ] = None,
) -> None:
    """The tables of Henzler et al. 2021 for their generator and for the default.

    Photographs map sets, captures each by the default, by the decoder, by the decoder without
    one part each, and as in the paper (PAPER, which takes half an hour each); compares style under
    the flash and ten other lights, diversity, colour and time. Interpolates each material and the
    next one, and compares draws of the prior with all map sets of the folder. Writes paper.csv and
    paper.md, with the paper's own figures, and prints the page.
    """
    from matcap.files.output import Output
    from matcap_lab.bench.paper import paper_experiments, paper_page
    from matcap_lab.experiment.results import command_line
    from matcap_lab.experiment.runner import choose
    from matcap_lab.simulate.specimen import subjects

    captured, every = subjects(material or (), sets), subjects((), sets)
    experiments = paper_experiments(captured, every, out, steps, vgg16)
    known = {name: name for each in experiments for name in each.configurations}
    chosen = choose(known, configuration or ())
    rows = []
    for each in experiments:
        some = {name: each.configurations[name] for name in chosen if name in each.configurations}
        if some and each.subjects:
            rows += _measured(replace(each, configurations=some), out, "paper")
    page = paper_page(rows, command_line())
    with Output.file(out / "paper.md") as file:
        file.write_text(page, encoding="utf-8")
    typer.echo(page)


def _measured(experiment: Experiment[Any, Any], out: Path, name: str = "") -> list[Trial]:
    """Measure the trials that the table NAME.csv in a folder lacks; returns the experiment's rows.

    The table's name is the experiment's by default.
    """
    from matcap.files.output import check_writable
    from matcap_lab.experiment.runner import run

    check_writable(out, 200_000_000)
    return run(experiment, out / f"{name or experiment.name}.csv", printer(quiet=False))


def _print(
    experiment: Experiment[Any, Any], out: Path, about: str, *, json: bool = False
) -> list[Trial]:
    """Measure, and print the table."""
    from matcap_lab.experiment.results import as_json, command_line, table

    rows = _measured(experiment, out)
    typer.echo(as_json(rows) if json else table(rows, command_line(), about))
    return rows


def _draw(
    rows: list[Trial],
    path: Path,
    title: str,
    axes: tuple[str, str] = ("seconds", "NSD"),
    least: float | None = None,
) -> None:
    from matcap_lab.experiment.page import draw
    from matcap_lab.experiment.results import means

    draw(means(rows), path, axes, title, least=least)
