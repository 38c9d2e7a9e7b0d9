"""`matcap blend`: materials between two materials."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from matcap.cli.options import QuietOption, ReplaceOption, seeded

_MARK = "matcap blend"  # what its strip says of who wrote it
_STRIP = "strip.png"
_MOST_STEPS = 256


@dataclass(frozen=True)
class Shares:
    """How far from A (0) to B (1), one or several times."""

    values: tuple[float, ...]


def shares(text: str | Shares) -> Shares:
    """'0.5' to one share, '0:1:5' to five from 0 to 1. Typer passes defaults through here too."""
    if isinstance(text, Shares):
        return text
    number = r"\d*\.?\d+|\d+\."
    match = re.fullmatch(rf"({number})(?::({number}):(\d{{1,9}}))?", text.strip())
    if not match:
        raise typer.BadParameter(f"'{text}' is neither a share such as 0.5 nor a range as 0:1:9")
    first = float(match[1])
    last, count = (float(match[2]), int(match[3])) if match[2] else (first, 1)
    if not (0 <= first <= 1 and 0 <= last <= 1):
        raise typer.BadParameter(f"'{text}' reaches outside 0 to 1")
    if count > _MOST_STEPS:
        raise typer.BadParameter(f"'{text}' asks for more than {_MOST_STEPS} steps")
    if count < (2 if match[2] else 1):
        raise typer.BadParameter(f"'{text}' asks for fewer than two steps")
    step = (last - first) / max(1, count - 1)
    return Shares(tuple(min(1.0, round(first + i * step, 6)) for i in range(count)))


def blend(
    first: Annotated[Path, typer.Argument(metavar="A", help="A .matcap file.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another one.")],
    share: Annotated[
        Shares,
        typer.Option(
            "-t",
            parser=shares,
            metavar="T|FROM:TO:COUNT",
            show_default="0.5",
            help="How far from A (0) to B (1), once or in up to 256 steps.",
        ),
    ] = Shares((0.5,)),
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for materials and strip.")] = (
        Path("blend")
    ),
    seed: Annotated[
        int,
        typer.Option(parser=seeded, metavar="SEED", help="Which piece is shown on the strip."),
    ] = 0,
    overwrite: ReplaceOption = False,
    quiet: QuietOption = False,
) -> None:
    """Walk from one material to another: a .matcap file a step, and a strip of pictures.

    Codes and network weights are interpolated alike; the ends are A and B themselves.
    """
    from functools import partial

    from matcap.field.header import provenance_says
    from matcap.field.material import Material
    from matcap.files.mark import check_replaceable
    from matcap.files.names import kept_plain
    from matcap.files.picture import write_picture
    from matcap.files.staging import check_writable, staged
    from matcap.space import between

    stems = "_".join(kept_plain(path.stem)[:60] for path in (first, second))
    places = 3 if len({round(t, 3) for t in share.values}) == len(share.values) else 6
    names = [f"{stems}_{t:.{places}f}.matcap" for t in share.values]
    check_replaceable(
        [out / name for name in (*names, _STRIP)],
        _MARK,
        inputs=[first, second],
        overwrite=overwrite,
        own=partial(provenance_says, "blend"),
    )
    ends = Material.load(first), Material.load(second)
    check_writable(out, 4_000_000 * len(share.values))
    materials = [between.blend(*ends, t) for t in share.values]
    with staged(out) as stage:
        for name, material in zip(names, materials, strict=True):
            material.save(stage / name)
        write_picture(between.strip(materials, seed=seed), stage / _STRIP, _MARK)
    if not quiet:
        for name in (*names, _STRIP):
            typer.echo(f"wrote {out / name}", err=True)
