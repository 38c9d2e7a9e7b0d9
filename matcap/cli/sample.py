"""`matcap sample` and `matcap blend`: materials from the prior, and between two materials."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
from matcap.field.options import BlendOptions, DrawOptions, SampleOptions

if TYPE_CHECKING:
    from collections.abc import Callable

    from matcap.field.material import Material


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
    """Materials by their seed, near a photograph where one is given."""
    from functools import partial

    from matcap.photo.load import load_photo
    from matcap.space.prior.store import DETAIL, load_prior

    space = load_prior(prior)
    if near.like is None:
        return partial(space.draw, spread=near.spread)
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
    stems = "_".join(usable_name(path.stem)[:60] for path in (first, second))
    places = 3 if len({round(t, 3) for t in asked.shares}) == len(asked.shares) else 6
    names = [f"{stems}_{t:.{places}f}.matcap" for t in asked.shares]
    outputs = [out / name for name in (*names, _STRIP)]
    check_output(outputs, inputs=[first, second], overwrite=overwrite)
    check_writable(out, max(path.stat().st_size for path in (first, second)) * len(asked.shares))
    materials = []
    with ShareDisplay.open(quiet=quiet) as shown:
        for number, t in enumerate(asked.shares, 1):
            materials.append(between.blend(one, other, t))
            shown.progress(number / len(asked.shares), "blending")
    with Output(out).stage() as stage:
        for name, material in zip(names, materials, strict=True):
            material.save(stage / name)
        write_picture(between.strip(materials, seed=asked.seed), stage / _STRIP)
    say = printer(quiet=quiet)
    if between.loses_patterns(one, other):
        say(_PATTERNLESS)
    for name in (*names, _STRIP):
        say(f"wrote {out / name}")
