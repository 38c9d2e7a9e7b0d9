"""`matcap synth`: any rectangle of a material's endless field, as a map set."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from matcap.cli import values
from matcap.cli.options import Normal, NormalOption, PngOption, QuietOption


def synth(
    material: Annotated[
        Path | None,
        typer.Argument(
            metavar="[MATERIAL]", help="A .matcap file; without one, the prior draws a material."
        ),
    ] = None,
    size: Annotated[
        values.Size,
        typer.Option(
            parser=values.size, metavar="WxH", show_default="1024x1024", help="Size in texels."
        ),
    ] = values.DEFAULT_SIZE,
    seed: Annotated[int, typer.Option(help="Which realisation of the material.")] = 0,
    region: Annotated[
        values.Region | None,
        typer.Option(
            parser=values.region,
            metavar="x,y,w,h",
            help="A rectangle anywhere in the endless field (y downwards), not --size.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder; by default a new one named after all this."),
    ] = None,
    png: PngOption = False,
    normal: NormalOption = Normal.gl,
    quiet: QuietOption = False,
) -> None:
    """Make more of a material: a map set of any size, seam-free and repeatable.

    The same material, seed and place give the same texels, whatever rectangle they are part of.
    Without a material the prior draws one, another for every seed.
    """
    from matcap.export.mapset import MapSetInfo, mapset_bytes, write_mapset
    from matcap.export.staging import check_writable
    from matcap.model.material import Material
    from matcap.prior.store import load_prior
    from matcap.synth.field import Field

    area = region or values.Region(0, 0, size.width, size.height)
    source = load_prior().draw(seed) if material is None else Material.load(material)
    name = source.name if material is None else material.stem
    folder = out or Path(f"{name}_{area.width}x{area.height}_seed{seed}")
    check_writable(folder, mapset_bytes(area.width, area.height, png=png))
    maps = Field(source, seed).read(area.x, area.y, area.width, area.height)
    info = MapSetInfo(name, seed, (area.x, area.y), dict(source.provenance))
    document = write_mapset(maps, folder, info, png=png, normal=normal.value)
    if not quiet:
        typer.echo(f"wrote {document}", err=True)
