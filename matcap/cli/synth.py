"""`matcap synth`, `export`: maps of a material as files; `sample`, `blend`: new materials."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from matcap.capture.settings import OutputSettings
from matcap.cli.options import (
    NOTHING,
    Fields,
    Given,
    JsonOption,
    OverwriteOption,
    PlainCommand,
    QuietOption,
    chosen,
    files_read,
    printer,
    with_settings,
)
from matcap.errors import ExitCode, MatcapError, UsageError
from matcap.export.options import ExportArea, ExportOptions
from matcap.field.options import BlendOptions, DrawOptions, ReadOptions, SampleOptions
from matcap.files import settings as values
from matcap.synth.request import SynthArea, SynthRequest, Work

if TYPE_CHECKING:
    from collections.abc import Callable

    from matcap.export.targets import Exported
    from matcap.field.material import Material
    from matcap.synth.request import SynthProgress


class SynthCommand(PlainCommand):
    """Command whose `--tile` may have no value: both axes."""

    _TILES = ("both", "x", "y", "piece")

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401
        """Give a lone --tile its value."""
        words = []
        for index, argument in enumerate(args):
            after = args[index + 1] if index + 1 < len(args) else ""
            words.append(argument)
            if argument == "--tile" and after not in self._TILES:
                if after.isalpha() and not Path(after).exists():  # no material's name
                    values.known(after, self._TILES, "--tile")
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

    from matcap.cli.display import ShareDisplay
    from matcap.synth.stream import synthesise, unfinished_bytes

    outputs = chosen(OutputSettings, exported)
    targets, textures = outputs.targets, outputs.maps
    if (targets or textures) and given.get("udim"):
        raise UsageError.at(
            "--export" if targets else "--maps",
            "a texture set cannot be exported",
            "leave out --udim",
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
    asked = SynthRequest(subject, area, name=name, read=chosen(ReadOptions, reading), **given)
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
        with ShareDisplay.open(quiet=quiet) as shown:

            def progress(now: SynthProgress) -> None:
                shown.progress(now.fraction, f"{now.rate / 1e6:.2f} million texels/s")

            inputs = (subject,) if isinstance(subject, Path) else ()
            working = {"workers": os.cpu_count() or 1, **working}
            work = Work(progress=progress, overwrite=overwrite, inputs=inputs, **working)
            document = synthesise(asked, folder, work)
    except KeyboardInterrupt:
        typer.echo("matcap: interrupted; the same command with --resume continues.", err=True)
        raise typer.Exit(ExitCode.INTERRUPTED) from None
    if targets or textures:
        from matcap.export.targets import engine_maps, export_mapset
    if textures:
        export_mapset(document, "substance", engine_maps(textures, asked.normal), "maps")
    for target in targets:
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

    drawn = drawing(chosen(DrawOptions, near))(seed)
    return drawn, drawn.name


# `matcap sample`: a sheet of materials drawn from the prior.


@with_settings
def sample(
    asked: Annotated[Given, Fields(SampleOptions)] = NOTHING,
    drawn_near: Annotated[Given, Fields(DrawOptions)] = NOTHING,
    out: Annotated[Path, typer.Option("--out", "-o", help="The picture, .png or .exr.")] = Path(
        "samples.png"
    ),
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
) -> None:
    """Draw random materials from the prior and render them under a flash.

    Each is near a random one of the prior's training photographs, or near the one given with
    --like. synth, relight, export, view and blend take them like any other material.
    """
    from matcap.cli.display import working
    from matcap.field.plane import check_seed
    from matcap.files.names import check_suffix
    from matcap.files.output import Output, check_output, check_writable
    from matcap.files.pixels import SUFFIXES, write_picture
    from matcap.space.prior.store import sample_sheet

    options, near = chosen(SampleOptions, asked), chosen(DrawOptions, drawn_near)
    count, seed, materials = options.count, options.seed, options.materials
    check_suffix(out, SUFFIXES, "picture")
    check_seed(seed + count - 1)
    files = [out]
    if materials is not None:
        files += [materials / f"{_called(near.like)}_{seed + i}.matcap" for i in range(count)]
    inputs = [file for file in (near.like, options.prior) if file is not None]
    check_output(files, inputs=inputs, overwrite=overwrite)
    draw = drawing(near, options.prior)
    if materials is not None:
        check_writable(materials, 4_000_000 * count)
    with working("drawing materials", quiet=quiet):
        drawn = [draw(seed + index) for index in range(count)]
        write_picture(sample_sheet(drawn, seed), out)
    written = [out]
    if materials is not None:
        with Output(materials).stage() as stage:
            for material in drawn:
                material.save(stage / f"{material.name}.matcap")
                written.append(materials / f"{material.name}.matcap")
    for path in written:
        printer(quiet=quiet)(f"wrote {path}")


def _called(like: Path | None) -> str:
    """Name of drawn materials, without their seed."""
    from matcap.files.names import usable_name

    return "drawn" if like is None else f"like_{usable_name(like.stem)}"


def drawing(near: DrawOptions, prior: Path | None = None) -> Callable[[int], Material]:
    """Materials by their seed, near a photograph or a captured material where one is given."""
    from functools import partial

    from matcap.field.opened import open_material
    from matcap.photo.load import load_photo
    from matcap.space.prior.store import DETAIL, load_prior

    space = load_prior(prior)
    if near.like is None:
        return partial(space.draw, spread=near.spread)
    if near.like.is_dir() or near.like.suffix.lower() == ".matcap":
        latent = open_material(near.like)[1].latent
        if latent is None:
            raise MatcapError.at(
                near.like, "this material has no latent code", "capture its photograph again"
            )
        place = space.near(latent)
    else:
        place = space.place(load_photo(near.like, long_side=DETAIL, noise=False))
    return partial(space.draw, near=place, spread=near.spread, name=_called(near.like))


# `matcap blend`: materials between two materials.

_STRIP = "strip.png"
_PATTERNLESS = (
    "A blend of two decoders has their colours, gloss and grain but not their patterns; captures "
    "without --no-drawing keep them."
)


@with_settings
def blend(
    first: Annotated[Path, typer.Argument(metavar="A", help="A .matcap file or its folder.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="A .matcap file or its folder.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for materials and strip.")] = (
        Path("blend")
    ),
    given: Annotated[Given, Fields(BlendOptions)] = NOTHING,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
) -> None:
    """Interpolate between two materials: a .matcap file for each step, and a strip of pictures.

    Exemplars are laid over each other and interpolated; of two decoders, latent vectors and
    network weights, and the exemplars that they draw from. The ends are A and B themselves.
    """
    from matcap.cli.display import ShareDisplay
    from matcap.field.opened import open_material
    from matcap.files.names import usable_name
    from matcap.files.output import Output, check_output, check_writable
    from matcap.files.pixels import write_picture
    from matcap.space import between

    asked = chosen(BlendOptions, given)
    (first, one), (second, other) = open_material(first), open_material(second)
    one, other = one.by(asked.generator), other.by(asked.generator)
    stems = "_".join(usable_name(path.stem)[:60] for path in (first, second))
    places = 3 if len({round(t, 3) for t in asked.shares}) == len(asked.shares) else 6
    names = [f"{stems}_{t:.{places}f}.matcap" for t in asked.shares]
    outputs = [out / name for name in (*names, _STRIP)]
    check_output(outputs, inputs=[first, second], overwrite=overwrite)
    check_writable(out, max(path.stat().st_size for path in (first, second)) * len(asked.shares))
    materials = []
    with ShareDisplay.open(quiet=quiet) as shown:
        for number, t in enumerate(asked.shares):
            shown.progress(number / len(asked.shares), "blending")
            materials.append(between.blend(one, other, t))
    with Output(out).stage() as stage:
        for name, material in zip(names, materials, strict=True):
            material.save(stage / name)
        write_picture(between.strip(materials, seed=asked.seed), stage / _STRIP)
    say = printer(quiet=quiet)
    if between.loses_patterns(one, other):
        say(_PATTERNLESS)
    for name in (*names, _STRIP):
        say(f"wrote {out / name}")


# `matcap export`: maps for another program.

_TEXEL_BYTES = 150  # memory of an export per texel, at least


@with_settings
def export(
    path: Annotated[
        Path, typer.Argument(metavar="PATH", help="A material, a map set or a folder with either.")
    ] = Path("."),
    to: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TARGET",
            help="materialx, usd, gltf, blender, mitsuba, or textures named and packed for unreal, "
            "unity-hdrp, unity-urp, godot, substance, polyhaven, ambientcg, gltf-textures or raw.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder; by default named after material and options."),
    ] = None,
    of: Annotated[Given, Fields(ExportArea)] = NOTHING,
    reading: Annotated[Given, Fields(ReadOptions)] = NOTHING,
    written: Annotated[Given, Fields(ExportOptions)] = NOTHING,
    overwrite: OverwriteOption = False,
    json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Write a material for another renderer or engine.

    Warns where the target cannot represent the material. See docs/guide/export.md.
    """
    from matcap.cli.display import working
    from matcap.errors import UsageError
    from matcap.export import targets
    from matcap.field.opened import open_tile, refuse_with_piece
    from matcap.files.output import check_output, check_writable
    from matcap.files.process import check_memory
    from matcap.files.settings import known, refuse_options

    if not to:
        names = ", ".join(targets.TARGETS)
        raise UsageError.at("--to", "no target is given", f"choose from {names}")
    if len(to) > 1:
        raise UsageError.at("--to", "one target at a time", "run the command once for each")
    target = known(to[0], targets.TARGETS, "--to")
    options = chosen(ExportOptions, written)
    if target in targets.DOCUMENTS:
        refuse_options(
            {"--normal": options.normal},
            f"only textures alone have this option, and {target} has a document",
            "leave it out",
        )
    read, area = chosen(ReadOptions, reading), chosen(ExportArea, of)
    size, seed, tile = area.size, area.seed, area.tile
    if tile:
        refuse_with_piece({"--size": size, "--seed": seed, "--variety": read.variety})
    largest = size or values.DEFAULT_SIZE
    if out is not None:
        check_writable(out, targets.export_bytes(*largest))
    check_memory(_TEXEL_BYTES * largest.width * largest.height, "--size", "ask for fewer texels")
    with working("synthesising", quiet=quiet or json):
        opened = open_tile(path, read, size=size, seed=seed, piece=tile is not None)
    asked_for = f"_{size}" * (size is not None) + f"_seed{seed}" * (seed is not None)
    asked_for += f"_{read.adjustments.file_part}" * read.adjustments.changes
    asked_for += f"_variety{read.variety}" * (read.variety is not None)
    asked_for += "_painted" * (opened.maps.painted is not None)
    asked_for += "_tile-piece" * (tile is not None)
    folder = out or Path(f"{opened.name}_{target}{asked_for}")
    sidecar = folder / targets.sidecar_name(opened.name, target)
    check_output([sidecar], overwrite=overwrite)
    check_writable(folder, targets.export_bytes(*opened.maps.size))
    job = targets.job_of(opened, path, options)
    inputs = [file for file in files_read(path) if file.name != sidecar.name]
    with working(f"exporting to {target}", quiet=quiet or json):
        done = targets.write_export(job, target, folder, inputs=inputs, overwrite=overwrite)
    _report(done, as_json=json, quiet=quiet)


def _report(done: Exported, *, as_json: bool, quiet: bool) -> None:
    if as_json:
        from json import dumps

        typer.echo(dumps(done.document(), indent=2, allow_nan=False))
        return
    if quiet:
        return
    typer.echo(f"wrote {done.folder} ({', '.join(done.files)})", err=True)
    for note in done.notes:
        typer.echo(f"note: {note}", err=True)
