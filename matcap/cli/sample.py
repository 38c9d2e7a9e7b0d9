"""`matcap sample`: a sheet of materials drawn from the prior."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from matcap.cli.fields import NOTHING, Fields, Given, chosen, with_settings
from matcap.cli.options import OverwriteOption, QuietOption, printer
from matcap.field.draw_options import DrawOptions, SampleOptions

if TYPE_CHECKING:
    from collections.abc import Callable

    from matcap.field.material import Material


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
    from matcap.files.picture import SUFFIXES, write_picture
    from matcap.space.prior.sample import sample_sheet

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
