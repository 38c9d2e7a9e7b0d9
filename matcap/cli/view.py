"""`matcap view`: a page that shows a material under a light that follows the pointer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from matcap.cli.options import (
    NOTHING,
    Fields,
    Given,
    OverwriteOption,
    QuietOption,
    chosen,
    printer,
    with_settings,
)
from matcap.errors import MatcapError
from matcap.field.options import ReadOptions
from matcap.files import settings as values
from matcap.files.settings import CheckedSettings, setting


@dataclass(frozen=True)
class ViewOptions(CheckedSettings):
    """Options of `matcap view`."""

    blend: Path | None = setting(None, metavar="FILE")
    """A second material to compare and blend with."""
    photo: Path | None = setting(None, metavar="FILE", otherwise="that of the folder")
    """A photograph to show next to the material."""
    seed: int = setting(0, metavar="SEED", parse=values.seed)
    """Seed of the realisation shown first."""
    port: int = setting(0, least=0, most=65535, otherwise="a free one")
    """Port of the server."""
    opens: bool = setting(True, option="open")
    """Open the page in the browser."""
    html: Path | None = setting(None, metavar="FILE")
    """Write a self-contained HTML file instead of running a server."""
    tile: int | None = setting(
        None, least=16, most=2048, otherwise="1024, or 512 where a page of 10 MB holds no more"
    )
    """Side of the seamless tile in --html, in texels, a multiple of 16."""


_SIDES, _LARGEST = (1024, 512), 10_000_000  # default texels of a tile, bytes of a page with them


@with_settings
def view(
    path: Annotated[
        Path,
        typer.Argument(help="A material, a map set's folder or a capture's folder."),
    ] = Path("."),
    given: Annotated[Given, Fields(ViewOptions)] = NOTHING,
    reading: Annotated[Given, Fields(ReadOptions, but=("normals", "adjust"))] = NOTHING,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
) -> None:
    """Show a material in the browser: endless plane, sphere and cylinder, under any light.

    The page is served to this machine only, until Ctrl-C. Its address is printed on stdout.
    """
    from matcap.cli.display import working
    from matcap.files.output import check_output
    from matcap.view.document import check_page_path, sealed_page, write_page
    from matcap.view.pages import reference_photograph
    from matcap.view.subject import Materials, open_subject

    def announce(address: str) -> None:
        typer.echo(address)
        printer(quiet=quiet)("Ctrl-C ends it.")

    read, asked = chosen(ReadOptions, reading), chosen(ViewOptions, given)
    blend, photo, html = asked.blend, asked.photo, asked.html
    if html is not None:
        check_page_path(html)
        inputs = [file for file in (path, blend, photo) if file is not None and file.is_file()]
        check_output([html], inputs=inputs, overwrite=overwrite)
    subject = open_subject(path, blend, asked.seed, read)
    material = subject.first if isinstance(subject, Materials) else None
    shown = reference_photograph(path, subject.facts.name, photo, material)
    if html is not None:
        with working("writing the page", quiet=quiet):
            for side in (asked.tile,) if asked.tile else _SIDES:
                page = sealed_page(subject, side, shown)
                if len(page) <= _LARGEST or material is None:
                    break
            write_page(page, html)
        printer(quiet=quiet)(f"wrote {html}")
        return
    try:
        from matcap.view.server import serve
    except ImportError as error:
        raise MatcapError(
            "the page needs the extra 'view'",
            remedy='pip install "matcap[view]", or write one file with --html',
        ) from error
    serve(subject, shown, port=asked.port, opens=asked.opens, announce=announce)
