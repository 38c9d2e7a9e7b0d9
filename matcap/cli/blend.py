"""`matcap blend`: materials between two materials."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from matcap.cli.fields import NOTHING, Fields, Given, chosen, with_settings
from matcap.cli.options import OverwriteOption, QuietOption, printer
from matcap.field.draw_options import BlendOptions

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
    from matcap.field.opened import open_material
    from matcap.files.names import usable_name
    from matcap.files.output import Output, check_output, check_writable
    from matcap.files.picture import write_picture
    from matcap.space import between

    asked = chosen(BlendOptions, given)
    (first, one), (second, other) = open_material(first), open_material(second)
    stems = "_".join(usable_name(path.stem)[:60] for path in (first, second))
    places = 3 if len({round(t, 3) for t in asked.shares}) == len(asked.shares) else 6
    names = [f"{stems}_{t:.{places}f}.matcap" for t in asked.shares]
    outputs = [out / name for name in (*names, _STRIP)]
    check_output(outputs, inputs=[first, second], overwrite=overwrite)
    check_writable(out, max(path.stat().st_size for path in (first, second)) * len(asked.shares))
    materials = [between.blend(one, other, t) for t in asked.shares]
    with Output(out).stage() as stage:
        for name, material in zip(names, materials, strict=True):
            material.save(stage / name)
        write_picture(between.strip(materials, seed=asked.seed), stage / _STRIP)
    say = printer(quiet=quiet)
    if between.loses_patterns(one, other):
        say(_PATTERNLESS)
    for name in (*names, _STRIP):
        say(f"wrote {out / name}")
