"""`matcap relight`: maps under another light, as a picture."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from matcap.cli.fields import NOTHING, Fields, Given, chosen, with_settings
from matcap.cli.inputs import files_read
from matcap.cli.options import (
    JsonOption,
    Normal,
    QuietOption,
    ReplaceOption,
    in_range,
    seeded,
    typed,
)
from matcap.field.options import ReadOptions
from matcap.files import values

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet
    from matcap.field.material import Material
    from matcap.field.opened import AdjustedMaterial
    from matcap.relight.plan import Plan
    from matcap.relight.render import Renderer
    from matcap.relight.scene import Scene


# Pixels of a flash picture whose photograph's sides are not known.
_SQUARE = (1024, 1024)
_LARGEST = 32768  # pixels of a side
_MOST_FRAMES, _MOST_LIGHTS = 10_000, 64
_PIXEL_BYTES = 48  # of memory that rendering and writing a picture take


class Motion(Enum):
    """What moves in an animation."""

    light_orbit = "light-orbit"
    turntable = "turntable"


@with_settings
def relight(
    path: Annotated[
        Path, typer.Argument(help="A material, a map set or a folder with either.")
    ] = Path("."),
    light: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME|x,y,z[,intensity]",
            show_default="top",
            help="A named light (flash, top, left), or the place of a point light. Of what was "
            "photographed, flash is the photograph's own: its camera, exposure and vignetting. "
            "Given several times, the lights add up.",
        ),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|NAME",
            help="A scene file (.toml), or flash, top, left, studio, sunset or turntable.",
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="Linear radiance in .exr, or an encoded .png."),
    ] = Path("relit.png"),
    size: Annotated[
        values.Size | None,
        typer.Option(
            parser=typed(values.sides(_LARGEST)),
            metavar="WxH",
            help="Pixels of the picture, at most 32768 a side; by default the scene's, or one a "
            "texel of a map set.",
        ),
    ] = None,
    seed: Annotated[
        int,
        typer.Option(parser=seeded, metavar="SEED", help="Which piece is read from a material."),
    ] = 0,
    reading: Annotated[Given, Fields(ReadOptions)] = NOTHING,
    effects: Annotated[
        str,
        typer.Option(metavar="auto|all|none|+x,-y", help="Which effects run (see --explain)."),
    ] = "auto",
    tolerance: Annotated[
        float | None,
        typer.Option(
            parser=in_range(0.0, 1e9),
            metavar="0..1e9",
            show_default="half an 8-bit step",
            help="What skipped effects may change at most, in code values from 0 to 1.",
        ),
    ] = None,
    explain: Annotated[
        bool, typer.Option("--explain", help="Print which effects ran, why, and their time.")
    ] = False,
    explain_map: Annotated[
        Path | None,
        typer.Option(metavar="FILE.png", help="A picture of the tiles that each effect ran in."),
    ] = None,
    animate: Annotated[
        Motion | None, typer.Option(help="Animation to .gif, .mp4 or numbered .exr.")
    ] = None,
    frames: Annotated[
        int, typer.Option(min=1, max=_MOST_FRAMES, help="Frames of the animation.")
    ] = 48,
    sheet: Annotated[
        values.Size | None,
        typer.Option(
            parser=typed(values.sides(_MOST_LIGHTS)),
            metavar="COLUMNSxROWS",
            help="A grid of lights in one picture, at most 64 a side.",
        ),
    ] = None,
    maps_from: Annotated[
        Path | None,
        typer.Option(
            help="A folder of maps that matcap did not make (ambientCG, Poly Haven names)."
        ),
    ] = None,
    normal: Annotated[
        Normal | None,
        typer.Option(help="Which way green points in normal maps of --maps-from."),
    ] = None,
    overwrite: ReplaceOption = False,
    json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Show a material under another light."""
    from functools import partial
    from itertools import chain

    from matcap.cli.relight_display import shown
    from matcap.errors import UsageError
    from matcap.field.opened import open_source
    from matcap.files.mark import check_replaceable
    from matcap.files.memory import check_memory
    from matcap.files.staging import check_writable
    from matcap.relight.effects.bound import DEFAULT_TOLERANCE
    from matcap.relight.output import (
        MARK,
        check_path,
        check_tiles_path,
        files_of,
        write_movie,
        write_still,
        write_tiles,
    )
    from matcap.relight.planning import parse_choice
    from matcap.relight.sequence import ANIMATIONS, light_sheet
    from matcap.relight.sequence import animate as animated

    if light and scene is not None:
        raise UsageError("a scene has its own lights", where="--light", remedy="leave it out")
    if animate is not None and sheet is not None:
        raise UsageError("a sheet does not move", where="--sheet", remedy="leave one out")
    read = chosen(ReadOptions, reading)
    if maps_from is not None and read != ReadOptions(read.generator):
        refused = {"adjust": "are not adjusted", "variety": "have no pieces"}
        name = next(name for name in reading if name != "generator")
        why = refused.get(name, "have their own")
        raise UsageError(f"maps of others {why}", where=f"--{name}", remedy="leave it out")
    if explain_map is not None and (animate is not None or sheet is not None):
        raise UsageError("this is of one picture", where="--explain-map", remedy="leave it out")
    check_path(out, moving=animate is not None)
    if explain_map is not None:
        check_tiles_path(explain_map)
    parse_choice(effects)
    outputs = files_of(out, frames if animate else None)
    outputs += [] if explain_map is None else [explain_map]
    inputs = files_read(path, maps_from, Path(scene) if scene else None)
    check_replaceable(outputs, MARK, inputs=inputs, overwrite=overwrite)
    wanted = _scene(scene, light or ["top"], size)
    if light == ["flash"] and maps_from is None:
        wanted = _photographed(path, size) or wanted
    limit = DEFAULT_TOLERANCE if tolerance is None else tolerance
    source = partial(open_source, path, read)
    renderer = _renderer(source, maps_from, normal, wanted, seed, quiet=quiet)
    film = renderer.film
    pictures = frames if animate else sheet.width * sheet.height if sheet else 1
    check_writable(out.parent, 16 * film.width * film.height * pictures)
    at_once = sheet.width * sheet.height if sheet else 1
    check_memory(
        _PIXEL_BYTES * film.width * film.height * at_once, "--size", "ask for a smaller picture"
    )
    if animate is not None:
        scenes = ANIMATIONS[animate.value](renderer.scene, frames)
        moving = animated(renderer, scenes, tolerance=limit, effects=effects)
        first = next(moving)
        rest = (one.radiance for one in moving)
        write_movie(chain([first.radiance], rest), out, film)
        plan = first.plan
    elif sheet is not None:
        picture, plan = light_sheet(
            renderer, sheet.width, sheet.height, tolerance=limit, effects=effects
        )
        write_still(picture, out, film)
    else:
        with shown(quiet=quiet or json) as progress:
            rendering = renderer.render(tolerance=limit, effects=effects, progress=progress)
        write_still(rendering.radiance, out, film)
        if explain_map is not None:
            write_tiles(rendering, explain_map)
        plan = rendering.plan
    _report(plan, out, as_json=json, explain=explain)
    if not quiet and not json:
        typer.echo(f"{maps_from or path}: {out}", err=True)


def _scene(name: str | None, lights: list[str], size: values.Size | None) -> Scene:
    from dataclasses import replace

    from matcap.relight.named import preset
    from matcap.relight.scene import Film, scene_from_light
    from matcap.relight.scenefile import read_scene

    if name is None:
        scene, *others = [scene_from_light(light) for light in lights]
        scene = replace(scene, lights=sum((one.lights for one in others), scene.lights))
    else:
        scene = read_scene(name) if name.lower().endswith(".toml") else preset(name)
    if size is None:
        return scene
    return replace(scene, film=replace(scene.film or Film(), width=size.width, height=size.height))


def _photographed(path: Path, size: values.Size | None) -> Scene | None:
    """The photograph's own scene, where a material records it."""
    from matcap.field.opened import open_photographed
    from matcap.relight.photographed import photographed_scene
    from matcap.relight.scene import Film

    known = open_photographed(path)
    if known is None:
        return None
    width, height = (size.width, size.height) if size else known.size or _SQUARE
    return photographed_scene(known.setup, Film(width, height), endless=known.endless)


def _renderer(
    source: Callable[[], MapSet | Material | AdjustedMaterial],
    maps_from: Path | None,
    normal: Normal | None,
    scene: Scene,
    seed: int,
    *,
    quiet: bool,
) -> Renderer:
    from matcap.relight.foreign.read import read_foreign
    from matcap.relight.render import Renderer

    if maps_from is None:
        return Renderer(source(), scene, seed=seed)
    foreign = read_foreign(maps_from, normal=normal.value if normal else None)
    if not quiet:
        for note in foreign.notes:
            typer.echo(f"{maps_from}: {note}", err=True)
    return Renderer(foreign.texture, scene, seed=seed)


def _report(plan: Plan, out: Path, *, as_json: bool, explain: bool) -> None:
    if as_json:
        import json

        report = {"out": str(out), "tolerance": plan.tolerance, "plan": plan.rows()}
        typer.echo(json.dumps(report, indent=2, allow_nan=False))
    elif explain:
        typer.echo(plan.table())
