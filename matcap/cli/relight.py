"""`matcap relight`: maps under another light, as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from matcap.cli import values
from matcap.cli.options import QuietOption


def relight(
    path: Annotated[
        Path, typer.Argument(help="A material, a map set or a folder with either.")
    ] = Path("."),
    light: Annotated[
        str,
        typer.Option(
            metavar="NAME|x,y,z[,intensity]",
            help="A named light (flash, top, left), or the place of a point light.",
        ),
    ] = "top",
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="Linear radiance in .exr, or an sRGB .png."),
    ] = Path("relit.png"),
    size: Annotated[
        values.Size,
        typer.Option(
            parser=values.size,
            metavar="WxH",
            show_default="1024x1024",
            help="Texels read from a material.",
        ),
    ] = values.DEFAULT_SIZE,
    seed: Annotated[int, typer.Option(help="Realisation read from a material.")] = 0,
    quiet: QuietOption = False,
) -> None:
    """Show a material under another light."""
    from matcap.export.picture import check_picture_path, write_picture
    from matcap.export.source import open_maps
    from matcap.export.staging import check_writable
    from matcap.relight.render import relight as render
    from matcap.relight.scene import scene_from_light

    check_picture_path(out)
    scene = scene_from_light(light)
    maps = open_maps(path, size=(size.width, size.height), seed=seed)
    check_writable(out.parent, 20 * maps.size[0] * maps.size[1])
    write_picture(render(maps, scene), out)
    if not quiet:
        typer.echo(f"wrote {out}", err=True)
