"""`matcap bench`: the commands that measure what the documentation claims."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from matcap.cli import bench_time, relight, synth
from matcap.cli.laboratory import require_laboratory
from matcap.cli.options import typed
from matcap.files import values

app = typer.Typer(help="Measure matcap on this machine.", no_args_is_help=True)
app.command("relight")(relight.bench)
app.command("fronts")(bench_time.fronts)
app.command("pairs")(bench_time.pairs)
app.command("report")(bench_time.report)
app.command("synth")(synth.bench)


@app.callback()
def _bench() -> None:
    """Measure matcap on this machine."""
    require_laboratory()


# Texels and degrees of what `bench fields --phases` measures.
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
def quality(
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for photographs, pictures and tables.")
    ] = Path("bench/quality"),
    material: Annotated[
        list[str] | None, typer.Option(help="Only this material; may be given several times.")
    ] = None,
    method: Annotated[
        list[str] | None, typer.Option(help="Only this method; may be given several times.")
    ] = None,
    preset: Annotated[str, typer.Option(help="Of the captures.")] = "standard",
    steps: Annotated[
        int | None, typer.Option(min=0, help="Fine-tuning steps, instead of the preset's.")
    ] = None,
    time_limit: Annotated[
        float | None,
        typer.Option(
            "--time", parser=typed(values.duration), metavar="TIME", help="For each capture."
        ),
    ] = None,
    detail: Annotated[
        int, typer.Option(min=64, max=8192, help="Texels along the photograph's long side.")
    ] = 1024,
) -> None:
    """How like the true material a capture looks under new lights.

    Photographs simulated materials, captures them, and compares the relit results with other true
    pieces of the same materials, beside simple ways to do the same. Errors are multiples of what
    two true pieces differ by. Writes quality.md, quality.csv and pictures; prints the table.
    """
    from matcap.capture import pipeline
    from matcap.capture.settings import CaptureSettings
    from matcap.files.staging import check_writable
    from matcap.lab.bench.quality import (
        METHODS,
        QualitySettings,
        markdown,
        run_quality,
        write_scores,
    )
    from matcap.lab.simulate.examples import EXAMPLES

    check_writable(out, 200_000_000)
    captured = CaptureSettings(preset, steps, time_limit, detail=detail, generator="decoder")
    scores = run_quality(
        lambda photo: pipeline.capture_file(photo, captured).material,
        out,
        materials=material or EXAMPLES,
        methods=method or METHODS,
        settings=QualitySettings(detail=detail),
        tell=lambda line: typer.echo(line, err=True),
    )
    command = shlex.join(["matcap", *sys.argv[1:]])
    write_scores(scores, out, command)
    typer.echo(markdown(scores, command))


@app.command()
def floors(
    material: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MATERIAL]...",
            help="Simulated materials by name, kinds (weave, or weave:7 for another), map sets.",
        ),
    ] = None,
    sets: Annotated[
        Path | None,
        typer.Option(help="Folder of artists' map sets; without names, all of them are taken."),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for photographs and floors.csv.")
    ] = Path("bench/floors"),
    detail: Annotated[
        int | None,
        typer.Option(min=128, max=4096, help="Of the captures; their own choice by default."),
    ] = None,
    judged: Annotated[
        int, typer.Option(min=256, max=4096, help="Texels along the long side that are compared.")
    ] = 512,
    stops: Annotated[
        float, typer.Option(min=-8.0, max=8.0, help="Of exposure above what a camera chooses.")
    ] = 0.0,
    jpeg: Annotated[bool, typer.Option("--jpeg", help="Photographs are JPEGs, not RAW.")] = False,
    preset: Annotated[str, typer.Option(help="Of the captures.")] = "standard",
    photographs: Annotated[
        list[int] | None,
        typer.Option(
            min=1, max=12, help="Of one piece, from so many places; may be given several times."
        ),
    ] = None,
    pixels: Annotated[
        int, typer.Option(min=320, max=8192, help="Across the photographs, which are 4:3.")
    ] = 1600,
    room: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=10.0,
            help="With --photographs: irradiance by the room, for a flash of 1 in plane units; "
            "each count is captured without and with one more photograph without flash.",
        ),
    ] = 0.0,
    union: Annotated[
        bool,
        typer.Option(
            "--union",
            help="With --photographs: the phone is moved by half a picture each time, and each "
            "count is captured also as all that they show.",
        ),
    ] = False,
    weights: Annotated[
        Path | None, typer.Option(help="SqueezeNet 1.1 by ncnn, instead of what comes along.")
    ] = None,
) -> None:
    """How far captures are from the truth, by a measure that nothing is tuned by.

    Photographs known materials, captures them, and compares photograph, piece and field with other
    true pieces under new lights, by the style that SqueezeNet sees. Errors are multiples of what
    true pieces differ by. Prints a table as it is measured, and what the maps tell for the truth.
    """
    from matcap.capture.settings import CaptureSettings
    from matcap.files.staging import check_writable
    from matcap.lab.floors.distance import Measure
    from matcap.lab.floors.run import FloorSettings, floors_csv, floors_markdown, run_floors
    from matcap.lab.floors.squeezenet import WEIGHTS, SqueezeNet
    from matcap.lab.floors.subjects import subjects
    from matcap.lab.simulate.photograph import PhoneCamera

    check_writable(out, 200_000_000)
    settings = FloorSettings(
        CaptureSettings(preset, detail=detail),
        judged,
        judged // 2,
        stops=stops,
        jpeg=jpeg,
        camera=PhoneCamera(width=pixels, height=3 * pixels // 8 * 2),
    )
    measure = Measure(SqueezeNet.load(weights or WEIGHTS))
    command = shlex.join(["matcap", *sys.argv[1:]])
    if photographs:
        from matcap.lab.bench.plot import draw
        from matcap.lab.floors.several import run_several, several_markdown, several_points
        from matcap.lab.simulate.hand_held import beside

        several = run_several(
            subjects(material or (), sets),
            photographs,
            out,
            settings,
            measure,
            room=room,
            hand=beside(settings.camera) if union else None,
            union=union,
            tell=typer.echo,
        )
        typer.echo(several_markdown(several, command))
        if several:
            draw(
                several_points(several),
                out / "photographs.png",
                title="What more photographs of one piece are worth",
                error="floors (SqueezeNet)",
            )
        return
    rows = run_floors(
        subjects(material or (), sets),
        out,
        settings,
        measure=measure,
        tell=lambda line: typer.echo(line, err=True),
    )
    out.mkdir(parents=True, exist_ok=True)
    (out / "floors.csv").write_text(floors_csv(rows))
    typer.echo(floors_markdown(rows, shlex.join(["matcap", *sys.argv[1:]])))


@app.command()
def metals(
    material: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MATERIAL]...",
            help="Simulated metals by name, kinds (rusted, or rusted:7 for another), map sets.",
        ),
    ] = None,
    sets: Annotated[Path | None, typer.Option(help="Folder of artists' map sets.")] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for photographs.")] = Path(
        "bench/metals"
    ),
    detail: Annotated[int, typer.Option(min=128, max=4096, help="Of the captures.")] = 512,
    preset: Annotated[str, typer.Option(help="Of the captures.")] = "instant",
    pixels: Annotated[
        int, typer.Option(min=256, max=8192, help="Of photographs, along the long side.")
    ] = 1600,
    known: Annotated[
        bool,
        typer.Option("--known-flash", help="The flash's strength is known, as by a card."),
    ] = False,
) -> None:
    """What is told of metals' F0: by channel, its hue, and beside what is no metal.

    Photographs known metals, captures them, and compares F0 where the truth is metal and where it
    is none, texel by texel. Prints a table as it is measured.
    """
    from matcap.brdf.metals import METAL_F0
    from matcap.capture.settings import CaptureSettings
    from matcap.files.staging import check_writable
    from matcap.lab.bench.metals import metals_markdown, run_metals
    from matcap.lab.floors.subjects import subjects
    from matcap.lab.simulate.photograph import PhoneCamera

    check_writable(out, 200_000_000)
    rows = run_metals(
        subjects(material or tuple(METAL_F0), sets),
        out,
        CaptureSettings(preset, detail=detail),
        camera=PhoneCamera(width=pixels, height=pixels // 8 * 6),
        known=known,
        tell=lambda line: typer.echo(line, err=True),
    )
    typer.echo(metals_markdown(rows, shlex.join(["matcap", *sys.argv[1:]])))


@app.command()
def fields(
    material: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MATERIAL]...",
            help="Simulated materials by name, kinds (weave, or weave:7 for another), map sets.",
        ),
    ] = None,
    sets: Annotated[
        Path | None,
        typer.Option(help="Folder of artists' map sets; without names, all of them are taken."),
    ] = None,
    phases: Annotated[
        bool,
        typer.Option("--phases", help="Also lattices of 2.5 to 300 texels, turned by some angle."),
    ] = False,
) -> None:
    """How far fields and repeated pieces of true maps are from the truth.

    The exemplar is the truth, so that only how it is rearranged, or made to repeat, is judged: in
    floors as `bench floors` counts them, by the length of joints for the truth's, and by how far a
    lattice's phase is off 16384 texels away. Prints a table, with the means of each group.
    """
    from matcap.lab.floors.fields import fields_markdown, grating, phase_off, run_fields
    from matcap.lab.floors.subjects import subjects

    rows = run_fields(subjects(material or (), sets), tell=lambda line: typer.echo(line, err=True))
    typer.echo(fields_markdown(rows, shlex.join(["matcap", *sys.argv[1:]])))
    for period, angle in _LATTICES if phases else ():
        off = phase_off(grating(period, angle, (1280, 960)))
        told = "no order" if off is None else f"{off:.4f} of a turn off"
        typer.echo(f"period {period:g} at {angle:g} degrees: {told}")


@app.command()
def gloss(
    slope: Annotated[
        list[float] | None,
        typer.Option(min=0.0, max=1.0, help="Of bumps; may be given several times; 0 if not."),
    ] = None,
    stops: Annotated[
        list[int] | None,
        typer.Option(min=-3, max=6, help="Above the camera's exposure; 0 to 3 if not given."),
    ] = None,
    piece: Annotated[
        bool, typer.Option("--piece", help="Of the captured piece, not of the coarse fit alone.")
    ] = False,
) -> None:
    """What is told of the gloss of plain materials, polished to matte, the more is clipped.

    Prints roughness and F0 as found, a line a material and a column an exposure.
    """
    from matcap.lab.bench.gloss import gloss_markdown, materials, run_gloss

    rows = run_gloss(
        materials(slope or (0.0,)),
        stops or (0, 1, 2, 3),
        piece=piece,
        tell=lambda line: typer.echo(line, err=True),
    )
    typer.echo(gloss_markdown(rows, shlex.join(["matcap", *sys.argv[1:]])))


@app.command()
def highlight(
    photographs: Annotated[
        list[Path] | None, typer.Argument(help="Real photographs; those without a highlight pass.")
    ] = None,
    simulated: Annotated[
        int, typer.Option(min=0, help="So many simulated photographs, of known offset and tilt.")
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Of the simulated ones.")] = 0,
    tells_fov: Annotated[
        bool, typer.Option("--fov/--no-fov", help="Whether the simulated ones tell theirs.")
    ] = True,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder for photograph and re-rendering side by side."),
    ] = None,
) -> None:
    """Whether the coarse fit keeps highlights, and finds flash and tilt where they were.

    Compares the highlight's centre, width and contrast in photographs and in re-renderings of
    their coarse fits. Prints a line a photograph, and errors of offset and tilt on simulated ones.
    """
    from matcap.lab.bench.highlight import keep, markdown, place, write_pair
    from matcap.lab.bench.highlight import simulated as make
    from matcap.photo.load import load_photo

    kept = []
    for path in photographs or []:
        photo = load_photo(path, noise=False)
        one, fit = keep(photo)
        if one is None or fit is None:
            continue
        kept.append(one)
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            write_pair(fit, photo, out / f"{path.stem}.png")
    placed = [place(*shot) for shot in make(simulated, seed, tells_fov=tells_fov)]
    typer.echo(markdown(kept, placed, shlex.join(["matcap", *sys.argv[1:]])))


@app.command()
def aligned(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for photographs.")] = Path(
        "bench/aligned"
    ),
    material: Annotated[
        list[str] | None, typer.Option(help="Only this material; may be given several times.")
    ] = None,
) -> None:
    """How right the maps of the photographed piece are, texel by texel.

    Photographs simulated materials and compares what is found with the true maps, by distance from
    the flash, beside the photograph as albedo and the coarse fit alone. Prints a table.
    """
    from matcap.files.staging import check_writable
    from matcap.lab.bench.aligned import aligned_markdown, run_aligned
    from matcap.lab.simulate.examples import EXAMPLES

    check_writable(out, 100_000_000)
    rows = run_aligned(out, material or EXAMPLES, tell=lambda line: typer.echo(line, err=True))
    typer.echo(aligned_markdown(rows))


@app.command()
def repetition(
    materials: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MATERIAL]...",
            help="Simulated materials by name, or .matcap files; six simulated ones by default.",
        ),
    ] = None,
    size: Annotated[int, typer.Option(min=512, max=8192, help="Texels a side.")] = 4096,
) -> None:
    """Whether a field by example shows its tricks.

    Its correlation with itself beside that of two seeds, sizes of verbatim copies, and how far two
    seeds are apart. Prints a table.
    """
    from matcap.lab.bench.repetition import example_of, markdown, measure
    from matcap.lab.simulate.examples import EXAMPLES

    found = [
        measure(Path(material).stem, example_of(material), size)
        for material in materials or EXAMPLES
    ]
    typer.echo(markdown(found, size, shlex.join(["matcap", *sys.argv[1:]])))
