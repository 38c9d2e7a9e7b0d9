"""`matcap export`: maps for another program."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from matcap.cli.options import (
    NOTHING,
    Fields,
    Given,
    JsonOption,
    OverwriteOption,
    QuietOption,
    chosen,
    files_read,
    with_settings,
)
from matcap.export.options import ExportArea, ExportOptions
from matcap.field.options import ReadOptions
from matcap.files import settings as values

if TYPE_CHECKING:
    from matcap.export.targets import Exported


_TEXEL_BYTES = 150  # memory of an export per texel, at least


@with_settings
def export(
    path: Annotated[
        Path, typer.Argument(help="A material, a map set or a folder with either.")
    ] = Path("."),
    to: Annotated[
        str | None,
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
    from matcap.export.job import ExportJob, known_scale, material_reach
    from matcap.export.targets import DOCUMENTS, TARGETS, export_bytes, sidecar_name, write_export
    from matcap.field.opened import open_tile, refuse_with_piece
    from matcap.files.output import check_output, check_writable
    from matcap.files.process import check_memory
    from matcap.files.settings import known, refuse_options

    if to is None:
        raise UsageError.at("--to", "there is no target", f"choose from {', '.join(TARGETS)}")
    target = known(to, TARGETS, "--to")
    options = chosen(ExportOptions, written)
    if target in DOCUMENTS:
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
        check_writable(out, export_bytes(*largest))
    check_memory(_TEXEL_BYTES * largest.width * largest.height, "--size", "ask for fewer texels")
    with working("synthesising", quiet=quiet or json):
        opened = open_tile(path, read, size=size, seed=seed, piece=tile is not None)
    asked_for = f"_{size}" * (size is not None) + f"_seed{seed}" * (seed is not None)
    asked_for += f"_{read.adjustments.file_part}" * read.adjustments.changes
    asked_for += f"_variety{read.variety}" * (read.variety is not None)
    asked_for += "_painted" * (opened.maps.painted is not None)
    asked_for += "_tile-piece" * (tile is not None)
    folder = out or Path(f"{opened.name}_{target}{asked_for}")
    sidecar = folder / sidecar_name(opened.name, target)
    check_output([sidecar], overwrite=overwrite)
    check_writable(folder, export_bytes(*opened.maps.size))
    job = ExportJob(
        opened.maps,
        opened.name,
        options.unit or known_scale(opened.provenance),
        options.bits,
        opened.provenance,
        options.container,
        material_reach(path, opened.name),
    )
    inputs = [file for file in files_read(path) if file.name != sidecar.name]
    with working(f"exporting to {target}", quiet=quiet or json):
        done = write_export(job, target, folder, options, inputs=inputs, overwrite=overwrite)
    _report(done, as_json=json, quiet=quiet)


def _report(done: Exported, *, as_json: bool, quiet: bool) -> None:
    if as_json:
        from json import dumps

        off = done.residual
        report = {
            "folder": str(done.folder),
            "files": done.files,
            "workflow": done.workflow,
            "residual": None if off is None else {"mean": off.mean, "worst": off.worst},
            "residuals": {
                name: {"mean": one.mean, "worst": one.worst} for name, one in done.residuals.items()
            },
            "notes": done.notes,
        }
        typer.echo(dumps(report, indent=2, allow_nan=False))
        return
    if quiet:
        return
    typer.echo(f"wrote {done.folder} ({', '.join(done.files)})", err=True)
    for note in done.notes:
        typer.echo(f"note: {note}", err=True)
