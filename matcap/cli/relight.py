"""`matcap relight`: maps under another light, as a picture; `matcap view`: as a page."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
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
    printer,
    with_settings,
)
from matcap.errors import MatcapError
from matcap.field.options import ReadOptions
from matcap.files import settings as values
from matcap.files.names import Note
from matcap.files.settings import CheckedSettings, setting
from matcap.relight.effects import DEFAULT_TOLERANCE

if TYPE_CHECKING:
    from matcap.brdf.stated import NormalStyle
    from matcap.example.example import Example
    from matcap.files.settings import Size
    from matcap.relight.plan import Plan
    from matcap.relight.render import Renderer
    from matcap.relight.scene import Scene

_LARGEST = 32768  # pixels of a side


@dataclass(frozen=True)
class RelightOptions(CheckedSettings):
    """Settings of a rendering: light, camera, size and accuracy."""

    light: Sequence[str] = setting(
        (), several=True, metavar="NAME|x,y,z[,intensity]", otherwise="top"
    )
    """A named light (flash, top, left, right, bottom), or the place of a point light. Of what was
    photographed, flash is the photograph's own: its camera, exposure and vignetting. Given several
    times, the lights add up."""
    scene: str | None = setting(None, metavar="FILE|NAME")
    """A scene file (.toml), the name of a light, studio, sunset or turntable."""
    size: Size | None = setting(None, metavar="WxH", parse=values.sides(_LARGEST))
    """Pixels of the picture, at most 32768 a side; by default the scene's, or one a texel of a map
    set."""
    seed: int = setting(0, metavar="SEED", parse=values.seed)
    """Seed of the material's realisation."""
    effects: str = setting("auto", metavar="auto|all|none|+x,-y", group="Advanced")
    """Effects to run (see --explain)."""
    tolerance: float = setting(
        DEFAULT_TOLERANCE,
        least=0.0,
        most=1e9,
        metavar="0..1e9",
        otherwise="half an 8-bit step",
        group="Advanced",
    )
    """Largest change by skipped effects, in code values from 0 to 1."""
    maps_from: Path | None = setting(None)
    """A folder of maps that matcap did not make (ambientCG, Poly Haven names)."""
    normal: NormalStyle | None = setting(None, words=("gl", "dx"), group="Advanced")
    """Direction of green in normal maps of --maps-from: up (gl) or down (dx)."""


# Size, pixels, of a flash picture if the photograph's is unknown.
_SQUARE = (1024, 1024)
_PIXEL_BYTES = 48  # of memory that rendering and writing a picture take


@with_settings
def relight(
    path: Annotated[
        Path, typer.Argument(metavar="PATH", help="A material, a map set or a folder with either.")
    ] = Path("."),
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Linear radiance in .exr, or an encoded .png.")
    ] = Path("relit.png"),
    given: Annotated[Given, Fields(RelightOptions)] = NOTHING,
    reading: Annotated[Given, Fields(ReadOptions)] = NOTHING,
    explain: Annotated[
        bool, typer.Option("--explain", help="Print which effects ran, why, and their time.")
    ] = False,
    overwrite: OverwriteOption = False,
    json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Show a material under another light."""
    from matcap.cli.display import ShareDisplay
    from matcap.errors import UsageError
    from matcap.files.names import check_suffix
    from matcap.files.output import check_output, check_writable
    from matcap.files.pixels import SUFFIXES, write_picture
    from matcap.files.process import check_memory
    from matcap.relight.render import encode, parse_choice

    asked = chosen(RelightOptions, given)
    scene, size, maps_from, light = asked.scene, asked.size, asked.maps_from, asked.light
    if light and scene is not None:
        raise UsageError.at("--light", "a scene has its own lights", "leave it out")
    if maps_from is not None and path != Path():
        raise UsageError.at("--maps-from", f"{path} is given too", "leave one of both out")
    read = chosen(ReadOptions, reading)
    if maps_from is not None and read != ReadOptions(read.generator):
        refused = {"adjust": "are not adjusted", "variety": "have no patches"}
        name = next(name for name in reading if name != "generator")
        why = refused.get(name, "have their own")
        raise UsageError.at(f"--{name}", f"maps of other sources {why}", "leave it out")
    check_suffix(out, SUFFIXES, "picture")
    parse_choice(asked.effects)
    inputs = files_read(path, Path(scene) if scene else None)
    inputs += [] if maps_from is None else [maps_from]
    check_output([out], inputs=inputs, overwrite=overwrite)
    wanted = _scene(scene, light or ["top"], size)
    if list(light) == ["flash"] and maps_from is None:
        wanted = _photographed(path, size) or wanted
    renderer = _renderer(path, read, asked, wanted, quiet=quiet)
    film = renderer.film
    pixels = film.width * film.height
    check_writable(out.parent, 16 * pixels)
    check_memory(_PIXEL_BYTES * pixels, "--size", "ask for a smaller picture")
    with ShareDisplay.open(quiet=quiet or json) as shown:
        rendering = renderer.render(
            progress=shown.progress, tolerance=asked.tolerance, effects=asked.effects
        )
        write_picture(rendering.radiance, out, partial(encode, film=film))
    _report(rendering.plan, out, as_json=json, explain=explain)
    printer(quiet=quiet or json)(f"{maps_from or path}: {out}")


def _scene(name: str | None, lights: Sequence[str], size: values.Size | None) -> Scene:
    from dataclasses import replace

    from matcap.relight.scene import Film, scene_from_light
    from matcap.relight.scenefile import preset, read_scene

    if name is None:
        scene, *others = [scene_from_light(light) for light in lights]
        scene = replace(scene, lights=sum((one.lights for one in others), scene.lights))
    else:
        scene = read_scene(name) if name.lower().endswith(".toml") else preset(name)
    if size is None:
        return scene
    return replace(scene, film=replace(scene.film or Film(), width=size.width, height=size.height))


def _photographed(path: Path, size: values.Size | None) -> Scene | None:
    """Camera and flash of a material's photograph as a scene, or None."""
    from matcap.field.opened import open_photographed
    from matcap.relight.scene import Film
    from matcap.relight.scenefile import photographed_scene

    known = open_photographed(path)
    if known is None:
        return None
    width, height = size or known.size or _SQUARE
    return photographed_scene(known.setup, Film(width, height), endless=known.endless)


def _renderer(
    path: Path, read: ReadOptions, asked: RelightOptions, scene: Scene, *, quiet: bool
) -> Renderer:
    from matcap.field.opened import open_source
    from matcap.relight.render import Renderer

    if asked.maps_from is None:
        source = _by_example(path, read) or open_source(path, read)
        return Renderer(source, scene, seed=asked.seed)
    from matcap.brdf.folder import find_mapsets
    from matcap.relight.foreign.read import read_foreign

    if asked.maps_from.is_dir() and find_mapsets(asked.maps_from):
        what = "matcap's own map set is read by names alone, without F0 and units"
        remedy = "give it without --maps-from"
        warnings.warn(f"{asked.maps_from}: {what}; {remedy}", Note, stacklevel=2)
    foreign = read_foreign(asked.maps_from, normal=asked.normal)
    for note in foreign.notes:
        printer(quiet=quiet)(f"{asked.maps_from}: {note}")
    return Renderer(foreign.texture, scene, seed=asked.seed)


def _by_example(path: Path, read: ReadOptions) -> Example | None:
    """A material that rearranges its exemplar, which needs no torch; None for anything else."""
    from matcap.example.example import read_exemplified

    files = sorted(path.glob("*.matcap")) if path.is_dir() else [path]
    if len(files) != 1 or files[0].suffix.lower() != ".matcap":
        return None
    if read.adjustments.changes or read.normals is not None:
        return None
    made = read_exemplified(files[0])
    if made is None or (read.generator or made.default) != "example":
        return None
    return made.example.varied(read.variety)


def _report(plan: Plan, out: Path, *, as_json: bool, explain: bool) -> None:
    if as_json:
        import json

        report = {"out": str(out), "tolerance": plan.tolerance, "plan": plan.rows()}
        typer.echo(json.dumps(report, indent=2, allow_nan=False))
    elif explain:
        typer.echo(plan.table())


# `matcap view`: a page that shows a material under a light that follows the pointer.


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


_SIDES, _LARGEST_PAGE = (1024, 512), 10_000_000  # default texels of a tile; bytes of its page


@with_settings
def view(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="PATH", help="A material, a map set's folder or a capture's folder."
        ),
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
    from matcap.files.output import check_output, check_writable
    from matcap.view.document import check_page_path, sealed_page, write_page
    from matcap.view.subject import Materials, open_subject, reference_photograph

    def announce(address: str) -> None:
        typer.echo(address)
        printer(quiet=quiet)("Ctrl-C ends it.")

    read, asked = chosen(ReadOptions, reading), chosen(ViewOptions, given)
    blend, photo, html = asked.blend, asked.photo, asked.html
    if html is not None:
        check_page_path(html)
        inputs = [file for file in (path, blend, photo) if file is not None and file.is_file()]
        check_output([html], inputs=inputs, overwrite=overwrite, option="--html")
        check_writable(html.parent, 0, option="--html")
    subject = open_subject(path, blend, asked.seed, read)
    material = subject.first if isinstance(subject, Materials) else None
    shown = reference_photograph(path, subject.facts.name, photo, material)
    if html is not None:
        with working("writing the page", quiet=quiet):
            for side in (asked.tile,) if asked.tile else _SIDES:
                page = sealed_page(subject, side, shown)
                if len(page) <= _LARGEST_PAGE or material is None:
                    break
            write_page(page, html)
        printer(quiet=quiet)(f"wrote {html}")
        return
    try:
        from matcap.view.server import serve
    except ImportError as error:
        raise MatcapError(
            "the page needs the extra 'view'",
            remedy='run: pip install "matcap[view]"; or write one file with --html',
        ) from error
    serve(subject, shown, port=asked.port, opens=asked.opens, announce=announce)
