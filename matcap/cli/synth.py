"""`matcap synth`: any rectangle of a material's endless field, as a map set."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from matcap.capture.settings import OutputSettings
from matcap.cli.options import (
    NOTHING,
    Fields,
    Given,
    OverwriteOption,
    PlainCommand,
    QuietOption,
    chosen,
    printer,
    with_settings,
)
from matcap.errors import ExitCode, UsageError
from matcap.field.options import DrawOptions, ReadOptions
from matcap.synth.request import SynthArea, SynthRequest, Work

if TYPE_CHECKING:
    from matcap.field.material import Material


class SynthCommand(PlainCommand):
    """Command whose `--tile` may have no value: both axes."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401
        """Give a lone --tile its value."""
        words = []
        for index, argument in enumerate(args):
            after = args[index + 1] if index + 1 < len(args) else ""
            words.append(argument)
            if argument == "--tile" and after not in ("both", "x", "y", "piece"):
                words.append("both")
        return super().parse_args(ctx, words)


@with_settings
def synth(
    material: Annotated[
        Path | None,
        typer.Argument(
            metavar="MATERIAL",
            help="A .matcap file or its folder; without one, the prior draws a material.",
        ),
    ] = None,
    near: Annotated[Given, Fields(DrawOptions)] = NOTHING,
    where: Annotated[Given, Fields(SynthArea)] = NOTHING,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder; by default named after material and options."),
    ] = None,
    given: Annotated[Given, Fields(SynthRequest)] = NOTHING,
    reading: Annotated[Given, Fields(ReadOptions, but=("normals",))] = NOTHING,
    working: Annotated[Given, Fields(Work)] = NOTHING,
    exported: Annotated[
        Given, Fields(OutputSettings, but=("size", "tile", "png", "normal"))
    ] = NOTHING,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
) -> None:
    """Synthesise a map set of any size from a material, without seams.

    The same material, seed and position give the same texels in every rectangle. Without a material
    the prior draws one by the seed; with --like, near a photograph.
    """
    import os

    from matcap.cli.display import SynthDisplay
    from matcap.files.process import keep_memory
    from matcap.synth.stream import synthesise, unfinished_bytes

    keep_memory()  # this process is matcap's own
    targets = exported.get("targets", ())
    if targets and given.get("udim"):
        raise UsageError.at(
            "--export",
            "a texture set cannot be exported",
            "leave out --udim, or give the material to matcap export --udim",
        )
    is_piece = given.get("tile") == "piece"
    if is_piece and {"size", "region"} & {*where}:
        raise UsageError.at(
            "--tile piece",
            "the periodic exemplar has a fixed size",
            "leave out --size and --region, or give --tile alone for a periodic texture",
        )
    area = chosen(SynthArea, where).rectangle
    subject, name = _subject(material, given.get("seed", 0), near)
    read = chosen(ReadOptions, reading)
    asked = SynthRequest(subject, area, name=name, read=read, **given)
    slug = _slug(asked)
    which = "" if is_piece else f"_{area.width}x{area.height}_seed{asked.seed}"
    folder = out or Path(f"{name}{which}{slug}")

    say = printer(quiet=quiet)
    left = 0 if working.get("resume") else unfinished_bytes(folder, name)
    if left:
        say(
            f"note: an interrupted run left {left / 1e6:.1f} MB of partial files here, which are "
            "discarded; --resume would continue them"
        )
    try:
        with SynthDisplay.open(quiet=quiet) as shown:
            inputs = (subject,) if isinstance(subject, Path) else ()
            working = {"workers": os.cpu_count() or 1, **working}
            work = Work(progress=shown.progress, overwrite=overwrite, inputs=inputs, **working)
            document = synthesise(asked, folder, work)
    except KeyboardInterrupt:
        typer.echo("matcap: interrupted; the same command with --resume continues.", err=True)
        raise typer.Exit(ExitCode.INTERRUPTED) from None
    for target in targets:
        from matcap.export.targets import export_mapset

        for note in export_mapset(document, target).notes:
            say(f"note: {target}: {note}")
    say(f"wrote {document}")


def _slug(asked: SynthRequest) -> str:
    """Part of the default folder's name that says what differs from the defaults."""
    area, read = asked.area, asked.read
    parts = {
        f"x{area.x}_y{area.y}": (area.x, area.y) != (0, 0),
        f"tile-{asked.tile}": asked.tile is not None,
        f"udim{asked.udim and '{}x{}'.format(*asked.udim)}": asked.udim is not None,
        f"{read.generator}": read.generator is not None,
        read.adjustments.file_part: read.adjustments.changes,
        f"variety{read.variety}": read.variety is not None,
        "mip": asked.mipmap,
        "png": asked.png,
        "dx": asked.normal == "dx",
    }
    return "".join(f"_{part}" for part, holds in parts.items() if holds)


def _subject(material: Path | None, seed: int, near: Given) -> tuple[Path | Material, str]:
    """The material's file, or a material drawn from the prior; and the name of its maps."""
    if material is not None:
        if near:
            raise UsageError.at(
                "--like" if "like" in near else "-t",
                "this applies only to a material drawn from the prior",
                "leave the material out, or the option",
            )
        from matcap.field.opened import material_file
        from matcap.files.names import usable_name

        file = material_file(material)
        return file, usable_name(file.stem)
    from matcap.cli.sample import drawing

    drawn = drawing(chosen(DrawOptions, near))(seed)
    return drawn, drawn.name
