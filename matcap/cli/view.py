"""`matcap view`: a page that shows a material under a light that follows the pointer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from matcap.cli.fields import NOTHING, Fields, Given, chosen, with_settings
from matcap.cli.options import QuietOption, ReplaceOption, seeded
from matcap.field.options import ReadOptions


@with_settings
def view(
    path: Annotated[
        Path,
        typer.Argument(
            help="A material, a map set's folder, a capture's folder, or a folder of captures."
        ),
    ] = Path("."),
    blend: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A second material to walk towards.")
    ] = None,
    photo: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            show_default="what the folder has",
            help="A photograph to show beside the piece.",
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option(parser=seeded, metavar="SEED", help="Which piece is shown first.")
    ] = 0,
    reading: Annotated[Given, Fields(ReadOptions, but=("normals",))] = NOTHING,
    port: Annotated[
        int, typer.Option(min=0, max=65535, show_default="a free one", help="Of the server.")
    ] = 0,
    opens: Annotated[
        bool, typer.Option("--open/--no-open", help="Open the page in the browser.")
    ] = True,
    html: Annotated[
        Path | None,
        typer.Option(
            "--html", metavar="FILE", help="Write one self-contained page instead of serving one."
        ),
    ] = None,
    tile: Annotated[
        int,
        typer.Option(
            min=16, max=2048, help="Side of the repeating tile in --html, a multiple of 16."
        ),
    ] = 512,
    overwrite: ReplaceOption = False,
    quiet: QuietOption = False,
) -> None:
    """Look at a material: endless plane, sphere and cylinder, under any light, in the browser.

    A folder of captures, as matcap batch leaves it, is shown as a library. The page is served to
    this machine alone, until Ctrl-C. Its address goes to stdout.
    """
    from matcap.errors import UsageError
    from matcap.files.mark import check_replaceable
    from matcap.view.document import MARK, check_page_path, sealed_page, write_page
    from matcap.view.library import Library, find_library
    from matcap.view.references import find_references
    from matcap.view.serve import serve, serve_library
    from matcap.view.subject import Materials, open_subject

    def announce(address: str) -> None:
        typer.echo(address)
        if not quiet:
            typer.echo("Ctrl-C ends it.", err=True)

    read = chosen(ReadOptions, reading)
    if html is not None:
        check_page_path(html)
        inputs = [file for file in (path, blend, photo) if file is not None and file.is_file()]
        check_replaceable([html], MARK, inputs=inputs, overwrite=overwrite)
    files = find_library(path)
    if files:
        given = {"--blend": blend, "--photo": photo, "--html": html, "--seed": seed or None}
        for option, value in given.items():
            if value is not None:
                raise UsageError(
                    "this folder has several materials", where=option, remedy="name one of them"
                )
        library = Library(files, read)
        name = path.resolve().name
        serve_library(library, name, port=port, opens=opens, announce=announce)
        return
    subject = open_subject(path, blend, seed, read)
    material = subject.first if isinstance(subject, Materials) else None
    references = find_references(path, subject.facts.name, photo, material)
    if html is not None:
        write_page(sealed_page(subject, tile, references, read.adjustments), html)
        if not quiet:
            typer.echo(f"wrote {html}", err=True)
        return
    serve(
        subject,
        port=port,
        references=references,
        adjust=read.adjustments,
        opens=opens,
        announce=announce,
    )
