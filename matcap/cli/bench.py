"""`matcap bench`: experiments that measure what the documentation claims, a command each.

Each writes a CSV row by row, resumes from it, and prints it as a table (matcap/lab/experiment).
This module turns options into an experiment's subjects and configurations.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from matcap.capture.settings import CaptureSettings
from matcap.cli.fields import NOTHING, Fields, Given, with_settings
from matcap.cli.options import JsonOption, command_line, printer, require_laboratory, typed
from matcap.errors import UsageError
from matcap.files import values

if TYPE_CHECKING:
    from matcap.lab.experiment.results import Trial
    from matcap.lab.experiment.runner import Experiment

app = typer.Typer(help="Measure matcap on this machine.", no_args_is_help=True)

MaterialArgument = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[MATERIAL]...",
        help="Simulated materials, kinds (weave; weave:7 is another draw) or map sets.",
    ),
]
OnlyOption = Annotated[
    list[str] | None, typer.Option(help="Measure only what is named; repeatable.")
]
SetsOption = Annotated[
    Path | None,
    typer.Option(help="Folder of artists' map sets; all of them if none is named."),
]
OutOption = Annotated[
    Path, typer.Option("--out", "-o", help="Folder for the table and the captures measured.")
]

_FRONTS = Path("bench/fronts")
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


@app.callback()
def _bench() -> None:
    """Measure matcap on this machine."""
    require_laboratory()


@app.command()
@with_settings
def quality(
    out: OutOption = Path("bench/quality"),
    material: OnlyOption = None,
    method: OnlyOption = None,
    given: Annotated[
        Given, Fields(CaptureSettings, only=("preset", "steps", "time_limit"))
    ] = NOTHING,
    detail: Annotated[
        int, typer.Option(min=64, max=8192, help="Texels along the photograph's long side.")
    ] = 1024,
) -> None:
    """Appearance error of captures under new lights.

    Photographs simulated materials, captures them, and compares the relit results, and those of
    simple baselines, with other true samples of the same materials: normalised style distance,
    1 is indistinguishable. Prints the table.
    """
    from matcap.capture import pipeline
    from matcap.lab.bench.methods import field_maps
    from matcap.lab.bench.nsd import QUALITY, quality_experiment
    from matcap.lab.measures.evaluator import EvaluationSettings

    captured = CaptureSettings(**given, detail=detail, generator="decoder")
    evaluation = EvaluationSettings(detail=detail, size=384)
    experiment = quality_experiment(
        lambda photo: field_maps(pipeline.capture_file(photo, captured).material, evaluation.width),
        out,
        materials=material or (),
        methods=method or (),
        settings=evaluation,
        captured=captured,
    )
    _print(experiment, out, QUALITY)


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
    weights: Annotated[
        Path | None, typer.Option(help="SqueezeNet 1.1 of ncnn, instead of the included weights.")
    ] = None,
) -> None:
    """Style distance of captures to the truth, by a measure to which nothing is tuned.

    Photographs known materials, captures them, and compares photograph, exemplar and field with
    other true samples under new lights: normalised style distance by SqueezeNet, 1 is
    indistinguishable. Prints the table, with statistics of the maps and of the truth.
    """
    from matcap.lab.bench import nsd, several
    from matcap.lab.measures.evaluator import EvaluationSettings
    from matcap.lab.measures.squeezenet import WEIGHTS
    from matcap.lab.simulate.hand_held import Hand, downward
    from matcap.lab.simulate.photograph import PhoneCamera
    from matcap.lab.simulate.specimen import subjects

    camera = PhoneCamera(width=pixels, height=3 * pixels // 8 * 2)
    evaluation = EvaluationSettings(judged, judged // 2, camera, weights=weights or WEIGHTS)
    settings = nsd.PhotographSettings(CaptureSettings(**given), stops, jpeg)
    chosen = subjects(material or (), sets)
    if not photographs:
        _print(nsd.nsd_experiment(chosen, out, settings, evaluation), out, nsd.ABOUT)
        return
    ambient = several.Ambient(room, union, downward(camera) if union else Hand())
    experiment = several.several_experiment(chosen, photographs, out, settings, evaluation, ambient)
    rows = _print(experiment, out, several.ABOUT)
    _draw(rows, out / "photographs.png", "Error by number of photographs of one sample")


@app.command()
def metals(
    material: MaterialArgument = None,
    sets: SetsOption = None,
    out: OutOption = Path("bench/metals"),
    detail: Annotated[int, typer.Option(min=128, max=4096, help="--detail of captures.")] = 512,
    preset: Annotated[str, typer.Option(help="--preset of captures.")] = "instant",
    pixels: Annotated[
        int, typer.Option(min=256, max=8192, help="Pixels along the photographs' long side.")
    ] = 1600,
    known: Annotated[
        bool,
        typer.Option("--known-flash", help="Give captures the flash's intensity, as a card does."),
    ] = False,
) -> None:
    """Errors of F0 of metals, by channel and in hue, and of dielectric parts.

    Photographs known metals, captures them, and compares F0 where the truth is metal and where it
    is dielectric, texel by texel. Prints the table.
    """
    from matcap.lab.bench.metals import ABOUT, metals_experiment
    from matcap.lab.simulate.materials.kinds.metal import SHEETS
    from matcap.lab.simulate.photograph import PhoneCamera
    from matcap.lab.simulate.specimen import subjects

    chosen = subjects(material or tuple(SHEETS), sets)
    camera = PhoneCamera(width=pixels, height=pixels // 8 * 6)
    settings = CaptureSettings(preset, detail=detail)
    _print(metals_experiment(chosen, out, settings, camera, known=known), out, ABOUT)


@app.command()
def fields(
    material: MaterialArgument = None,
    sets: SetsOption = None,
    phases: Annotated[
        bool,
        typer.Option("--phases", help="Also measure rotated lattices of 2.5 to 300 texels."),
    ] = False,
    out: OutOption = Path("bench/fields"),
) -> None:
    """Errors of fields and periodic tiles synthesised from true maps.

    The exemplar is the truth, so that only synthesis is measured: by normalised style distance as
    in `bench floors`, by the length of joints relative to the truth's, and by the phase error of a
    lattice 16384 texels away. Prints the table.
    """
    from matcap.lab.bench.fields import ABOUT, fields_experiment, grating, phase_off
    from matcap.lab.simulate.specimen import subjects

    _print(fields_experiment(subjects(material or (), sets)), out, ABOUT)
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
    piece: Annotated[
        bool, typer.Option("--piece", help="Measure the exemplar, not only the coarse fit.")
    ] = False,
    out: OutOption = Path("bench/gloss"),
) -> None:
    """Estimates of roughness and F0 of plain materials, polished to matte, over exposures.

    Prints the table, a row for each material and exposure.
    """
    from matcap.lab.bench.gloss import ABOUT, gloss_experiment, materials

    chosen = materials(slope or (0.0,))
    _print(gloss_experiment(chosen, stops or (0, 1, 2, 3), exemplar=piece), out, ABOUT)


@app.command()
def camera(
    material: MaterialArgument = None,
    sets: SetsOption = None,
    photographs: Annotated[
        Path | None, typer.Option(help="Folder of real photographs by one camera.")
    ] = None,
    begins: Annotated[str, typer.Option(help="Beginning of the names to take.")] = "",
    falloff: Annotated[
        tuple[float, float],
        typer.Option(help="Simulated falloff: coefficients of r^2 and r^4 in the log."),
    ] = (0.6, 1.2),
    jpeg: Annotated[bool, typer.Option("--jpeg", help="Simulate JPEGs, not RAW.")] = False,
    out: OutOption = Path("bench/camera"),
) -> None:
    """Coarse fits of photographs: vignetting, tone curve, metal; errors of simulated ones.

    Prints the table.
    """
    from matcap.batch.input_folder import find_samples
    from matcap.lab.bench.cameras import ABOUT, camera_experiment
    from matcap.lab.simulate.specimen import subjects

    samples = find_samples(photographs) if photographs else []
    real = [one.photos[0] for one in samples if one.photos[0].name.startswith(begins)]
    specimens = [] if photographs else subjects(material or (), sets)
    _print(camera_experiment(real, specimens, falloff, developed=jpeg), out, ABOUT)


@app.command()
def highlight(
    photographs: Annotated[
        list[Path] | None,
        typer.Argument(help="Real photographs; without a highlight they are skipped."),
    ] = None,
    simulated: Annotated[
        int, typer.Option(min=0, help="Number of simulated photographs, of known offset and tilt.")
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the simulated photographs.")] = 0,
    states_fov: Annotated[
        bool,
        typer.Option("--fov/--no-fov", help="State the field of view in simulated photographs."),
    ] = True,
    out: OutOption = Path("bench/highlight"),
) -> None:
    """Errors of the coarse fit's highlight, flash offset and tilt.

    Compares the highlight's centre, width and contrast in photographs and in re-renderings of
    their coarse fits, which are written side by side. Prints the table, and errors of offset and
    tilt on simulated ones.
    """
    from matcap.lab.bench.highlight import ABOUT, highlight_experiment

    experiment = highlight_experiment(photographs or (), simulated, seed, out, has_fov=states_fov)
    _print(experiment, out, ABOUT)


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
    from matcap.lab.bench.repetition import ABOUT, repetition_experiment

    _print(repetition_experiment(materials or (), size), out, ABOUT)


@app.command()
def fronts(
    out: OutOption = _FRONTS,
    sets: Annotated[
        Path | None,
        typer.Option(help="Folder of artists' map sets; six held-out ones are used."),
    ] = None,
    point: Annotated[
        list[str] | None,
        typer.Option(help="Measure only this point of --list; may be repeated."),
    ] = None,
    material: Annotated[
        list[str] | None,
        typer.Option(help="Measure only this material, kind or set; may be repeated."),
    ] = None,
    seed: Annotated[
        list[int] | None, typer.Option(help="Seed of captures; may be repeated; default 0.")
    ] = None,
    show: Annotated[
        bool, typer.Option("--list", help="Print points and materials, and exit.")
    ] = False,
) -> None:
    """Error, seconds and memory of captures, over work, photographs, detail, time and generators.

    Simulates phone photographs of materials with known truth, runs `matcap capture` on them and
    compares its output with other true samples. Rows measured by another version of matcap are
    kept. Wall times are meaningful only on an otherwise idle machine.
    """
    from matcap.lab.bench.fronts import USUAL, WAYS, Fronts, fronts_experiment

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
def pairs(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder that `bench fronts` wrote.")
    ] = _FRONTS,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for pages of pairs and pairs.csv.")
    ] = Path("bench/pairs"),
    count: Annotated[int, typer.Option("-n", min=1, help="Number of pairs.")] = 40,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the choice of pairs and of their sides.")
    ] = 0,
) -> None:
    """Pages for blind comparison: pairs of captures of the fronts, the truth between them.

    Look at the pages, write left, right or neither into the column `nearer` of pairs.csv, and put
    it next to fronts.csv: bench report counts how often each measure agrees.
    """
    from matcap.lab.bench.pairs import write_pairs

    typer.echo(str(write_pairs(folder, out, count, seed)))


@app.command()
def relight(
    scenes: Annotated[
        list[Path] | None,
        typer.Argument(help="Scene files or names; default: studio, sunset, turntable."),
    ] = None,
    json: JsonOption = False,
    tolerances: Annotated[
        bool,
        typer.Option("--tolerances", help="Measure time against accuracy, by tolerance."),
    ] = False,
    mitsuba: Annotated[
        bool, typer.Option("--mitsuba", help="Compare the named scenes with Mitsuba 3.")
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
    a table and a plot. With --mitsuba the named scenes' time and Mitsuba's to 1 % of noise.
    """
    from matcap.lab.bench import relight as bench

    if mitsuba:
        _print(bench.mitsuba_experiment(), out, bench.NOISE, json=json)
    elif tolerances:
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
        list[str] | None,
        typer.Option(metavar="WxH", help="Block of the field; may be repeated."),
    ] = None,
    workers: Annotated[
        list[int] | None, typer.Option("--workers", "-j", min=1, help="Threads; default: 1 and 2.")
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Repetitions; the median counts.")] = 3,
) -> None:
    """Speed of synthesis, and of the paper's form of the same network.

    Prints the table. The paper's network takes a few gigabytes.
    """
    from matcap.lab.bench.synth import ABOUT, BLOCKS, NETWORKS, SynthSettings, synth_experiment
    from matcap.space.decoder import ALIGNMENT

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
    from matcap.lab.bench.profile import ABOUT, profile_experiment

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
    from matcap.lab.bench.pairs import agreement
    from matcap.lab.bench.presentations import presentation_of
    from matcap.lab.experiment.page import write_page

    presentations = {table: presentation_of(table) for table in tables}
    more = {table: agreement(table) for table in tables}
    write_page(presentations, out, ["matcap", *sys.argv[1:]], more)
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
    from matcap.files.staging import staged_file
    from matcap.lab.bench.paper_tables import paper_experiments, paper_page
    from matcap.lab.experiment.runner import choose
    from matcap.lab.simulate.specimen import subjects

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
    with staged_file(out / "paper.md") as file:
        file.write_text(page, encoding="utf-8")
    typer.echo(page)


def _measured(experiment: Experiment[Any, Any], out: Path, name: str = "") -> list[Trial]:
    """Measure the trials that the table NAME.csv in a folder lacks; returns the experiment's rows.

    The table's name is the experiment's by default.
    """
    from matcap.files.staging import check_writable
    from matcap.lab.experiment.runner import run

    check_writable(out, 200_000_000)
    table = out / f"{name or experiment.name}.csv"
    return run(experiment, table, printer(quiet=False))


def _print(
    experiment: Experiment[Any, Any], out: Path, about: str, *, json: bool = False
) -> list[Trial]:
    """Measure, and print the table."""
    from matcap.lab.experiment.results import as_json, table

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
    from matcap.lab.experiment.plot import draw
    from matcap.lab.experiment.results import means

    draw(means(rows), path, axes, title, least=least)
