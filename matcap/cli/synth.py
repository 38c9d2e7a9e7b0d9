"""`matcap synth`: any rectangle of a material's endless field, as a map set."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from matcap.cli.options import (
    AdjustOption,
    ExportOption,
    GeneratorOption,
    LikeOption,
    Normal,
    NormalOption,
    OverwriteOption,
    PngOption,
    QuietOption,
    SpreadOption,
    VarietyOption,
    seeded,
    typed,
)
from matcap.cli.plain_command import PlainCommand
from matcap.errors import ExitCode, UsageError
from matcap.files import values

if TYPE_CHECKING:
    from matcap.field.material import Material
    from matcap.field.plane import Rectangle
    from matcap.synth.precision import ChosenPrecision
    from matcap.synth.request import SynthProgress
    from matcap.synth.synthesise import Growth, Repeating, SynthRequest

_STRIP = values.Size(4096, 256)  # the paper's own example
_EVERY = 10.0  # seconds between lines of progress where there is no terminal


class TileAxes(Enum):
    """Along which axes the maps repeat, or the photographed piece itself along both."""

    both = "both"
    x = "x"
    y = "y"
    piece = "piece"


class PrecisionName(Enum):
    """How exactly to compute."""

    fp32 = "fp32"
    bf16 = "bf16"
    auto = "auto"


class Device(Enum):
    """Where to compute."""

    auto = "auto"
    cpu = "cpu"
    cuda = "cuda"


class SynthCommand(PlainCommand):
    """Lets `--tile` stand alone, for both axes."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401
        """Give a lone --tile its value."""
        told = []
        for index, argument in enumerate(args):
            after = args[index + 1] if index + 1 < len(args) else ""
            told.append(argument)
            if argument == "--tile" and after not in [axis.value for axis in TileAxes]:
                told.append(TileAxes.both.value)
        return super().parse_args(ctx, told)


def synth(
    material: Annotated[
        Path | None,
        typer.Argument(
            metavar="MATERIAL",
            help="A .matcap file or the folder it stands in; without one, the prior draws a "
            "material.",
        ),
    ] = None,
    like: LikeOption = None,
    spread: SpreadOption = None,
    size: Annotated[
        values.Size | None,
        typer.Option(
            parser=typed(values.size),
            metavar="WxH",
            show_default="1024x1024",
            help="Size in texels: 4096x256, or 2K, 4K, 8K; as much as the disk has room for.",
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option(parser=seeded, metavar="SEED", help="Which piece of the material.")
    ] = 0,
    region: Annotated[
        values.Region | None,
        typer.Option(
            parser=typed(values.region),
            metavar="x,y,w,h",
            help="A rectangle anywhere in the endless field (y downwards), not --size.",
        ),
    ] = None,
    tile: Annotated[
        TileAxes | None,
        typer.Option(
            help="Repeat exactly along both axes, or along x or y alone; piece: the photographed "
            "piece itself, made to repeat, at about its own size."
        ),
    ] = None,
    udim: Annotated[
        values.Size | None,
        typer.Option(
            parser=typed(values.size),
            metavar="CxR",
            help="A texture set of C columns (at most 10) and R rows (at most 900), each tile of "
            "the given size.",
        ),
    ] = None,
    single: Annotated[bool, typer.Option("--single", help="All maps in one EXR file.")] = False,
    mip: Annotated[
        bool, typer.Option("--mip", help="Mip-mapped EXR files, as texture readers like them.")
    ] = False,
    blend: Annotated[
        Path | None,
        typer.Option(metavar="MATERIAL", help="Grow into this material where --mask is white."),
    ] = None,
    mask: Annotated[
        Path | None,
        typer.Option(help="Grey picture for --blend, stretched over the rectangle asked for."),
    ] = None,
    mask_over: Annotated[
        values.Region | None,
        typer.Option(
            parser=typed(values.region),
            metavar="x,y,w,h",
            help="Stretch the mask over this instead.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder; by default a new one named after all this."),
    ] = None,
    png: PngOption = False,
    normal: NormalOption = Normal.gl,
    export: ExportOption = None,
    workers: Annotated[
        int | None,
        typer.Option("--workers", "-j", min=1, max=1024, help="Processes; by default one a core."),
    ] = None,
    generator: GeneratorOption = None,
    adjust: AdjustOption = None,
    variety: VarietyOption = None,
    precision: Annotated[
        PrecisionName,
        typer.Option(help="auto: as much bf16 as changes no map by half an 8-bit step."),
    ] = PrecisionName.fp32,
    device: Annotated[
        Device, typer.Option(help="auto: a CUDA device where PyTorch sees one.")
    ] = Device.auto,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="tcp://HOST:PORT", help="Send blocks to this dask scheduler."),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with what an interrupted run left.")
    ] = False,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
) -> None:
    """Make more of a material: a map set of any size, seam-free and repeatable.

    The same material, seed and place give the same texels, whatever rectangle they are part of.
    Without a material the prior draws one, another for every seed; --like a photograph, near it.
    """
    import os

    from matcap.brdf.adjust import parse_adjustments
    from matcap.synth.request import Files, Work
    from matcap.synth.synthesise import SynthRequest, synthesise
    from matcap.synth.unfinished import unfinished_bytes
    from matcap.synth.workers import keep_memory

    keep_memory()  # this process is matcap's own
    targets: tuple[str, ...] = ()
    if export:
        from matcap.export.targets import check_targets

        targets = check_targets(export)
    if targets and (single or udim):
        raise UsageError(
            "only plain map sets are exported", where="--export", remedy="leave --single or --udim"
        )
    growth = _growth(blend, mask, mask_over)
    if size is not None and region is not None:
        raise UsageError(
            "a rectangle has a size of its own", where="--region", remedy="leave --size out"
        )
    is_piece = tile is TileAxes.piece
    if is_piece and (size is not None or region is not None):
        raise UsageError(
            "the photographed piece has a size of its own",
            where="--tile piece",
            remedy="leave --size and --region out, or let the field repeat, with --tile alone",
        )
    sides = size or values.DEFAULT_SIZE
    area = _rectangle(region or values.Region(0, 0, sides.width, sides.height))
    files = Files(png, normal.value, single, mip, (udim.width, udim.height) if udim else None)
    subject, name = _subject(material, seed, like, spread)
    axes: Repeating | None = tile.value if tile else None
    asked = SynthRequest(
        subject, area, seed, name, files, axes, growth, precision.value, device.value,
        generator and generator.value, parse_adjustments(adjust), variety,
    )  # fmt: skip
    told_apart = _told_apart(asked)
    which = "" if is_piece else f"_{area.width}x{area.height}_seed{seed}"
    folder = out or Path(f"{name}{which}{told_apart}")

    def told(choice: ChosenPrecision) -> None:
        if precision is PrecisionName.auto and not quiet:
            typer.echo(choice.sentence(), err=True)

    left = 0 if resume else unfinished_bytes(folder, name)
    if left and not quiet:
        typer.echo(
            f"note: an interrupted run left {left / 1e6:.1f} MB here, which this one begins anew; "
            "--resume would go on with them",
            err=True,
        )
    try:
        with _progress(quiet=quiet) as tell:
            inputs = tuple(file for file in (subject, blend, mask) if isinstance(file, Path))
            work = Work(workers or os.cpu_count() or 1, scheduler, resume, tell, overwrite, inputs)
            document = synthesise(asked, folder, work, told)
    except KeyboardInterrupt:
        typer.echo("matcap: interrupted; the same command with --resume goes on.", err=True)
        raise typer.Exit(ExitCode.INTERRUPTED) from None
    for target in targets:
        from matcap.export.targets import export_mapset

        done = export_mapset(document, target)
        if not quiet:
            for note in done.notes:
                typer.echo(f"note: {target}: {note}", err=True)
    if not quiet:
        typer.echo(f"wrote {document}", err=True)


def _told_apart(asked: SynthRequest) -> str:
    """What the default folder's name says beside name, size and seed."""
    area, files, growth = asked.area, asked.files, asked.growth
    parts = {
        f"x{area.x}_y{area.y}": (area.x, area.y) != (0, 0),
        f"tile-{asked.tile}": asked.tile is not None,
        f"udim{files.udim and '{}x{}'.format(*files.udim)}": files.udim is not None,
        f"into-{growth and Path(str(growth.material)).stem}": growth is not None,
        f"{asked.generator}": asked.generator is not None,
        f"{asked.precision}": asked.precision != "fp32",
        asked.adjust.file_part: asked.adjust.changes,
        f"variety{asked.variety}": asked.variety is not None,
        "single": files.single,
        "mip": files.mipmap,
        "png": files.png,
        "dx": files.normal == "dx",
    }
    return "".join(f"_{part}" for part, holds in parts.items() if holds)


def _subject(
    material: Path | None, seed: int, like: Path | None, spread: float | None
) -> tuple[Path | Material, str]:
    """The material's file, or a material that the prior draws; and what its maps are called."""
    if material is not None:
        for option, given in (("--like", like), ("-t", spread)):
            if given is not None:
                raise UsageError(
                    "only a material that the prior draws is like a photograph",
                    where=option,
                    remedy="leave the material out, or the option",
                )
        from matcap.field.opened import material_file
        from matcap.files.names import kept_plain

        file = material_file(material)
        return file, kept_plain(file.stem)
    from matcap.cli.sample import drawing

    drawn = drawing(None, like, spread)(seed)
    return drawn, drawn.name


def _growth(blend: Path | None, mask: Path | None, over: values.Region | None) -> Growth | None:
    """What to grow into: a blend needs a mask, and the mask's options a blend."""
    from matcap.synth.synthesise import Growth

    for name, option in (("--mask", mask), ("--mask-over", over)):
        if blend is None and option is not None:
            raise UsageError("there is nothing to blend with", where=name, remedy="give --blend")
    if blend is None:
        return None
    if mask is None:
        raise UsageError("there is no mask", where="--blend", remedy="give a picture with --mask")
    return Growth(blend, mask, None if over is None else _rectangle(over))


def _rectangle(region: values.Region) -> Rectangle:
    from matcap.field.plane import Rectangle

    return Rectangle(region.x, region.y, region.width, region.height)


@contextmanager
def _progress(*, quiet: bool) -> Iterator[Callable[[SynthProgress], None]]:
    """Tell of the work: a bar on a terminal, a line now and then elsewhere."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    console = Console(stderr=True)
    if quiet or not console.is_terminal or console.is_dumb_terminal:
        said = time.monotonic()

        def tell(now: SynthProgress) -> None:
            nonlocal said
            if not quiet and time.monotonic() - said >= _EVERY:
                said = time.monotonic()
                typer.echo(f"  {now.fraction:6.1%}  {_rate(now)}", err=True)

        yield tell
        return
    columns = (
        TextColumn("{task.percentage:>3.0f} %"),
        BarColumn(),
        TextColumn("{task.fields[rate]}"),
    )
    with Progress(*columns, console=console, transient=True) as bars:
        task = bars.add_task("texels", total=1.0, rate="")
        yield lambda now: bars.update(task, completed=now.fraction, rate=_rate(now))


def _rate(now: SynthProgress) -> str:
    """Texels a second, and how long there is to go."""
    left = now.seconds_left
    time_left = "" if left is None else f", {values.spoken_duration(left)} left"
    return f"{now.rate / 1e6:.2f} million texels/s{time_left}"
