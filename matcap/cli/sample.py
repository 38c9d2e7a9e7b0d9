"""`matcap sample`: a sheet of materials drawn from the prior."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from matcap.cli.options import LikeOption, QuietOption, ReplaceOption, SpreadOption, seeded

if TYPE_CHECKING:
    from collections.abc import Callable

    from matcap.field.material import Material


_MARK = "matcap sample"  # what its picture says of who wrote it


def sample(
    count: Annotated[int, typer.Option("-n", min=1, max=256, help="How many.")] = 16,
    seed: Annotated[
        int,
        typer.Option(parser=seeded, metavar="SEED", help="Of the first; the others follow."),
    ] = 0,
    like: LikeOption = None,
    spread: SpreadOption = None,
    prior: Annotated[
        Path | None, typer.Option(help="A prior's file, instead of the one that comes along.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="The picture, .png or .exr.")] = Path(
        "samples.png"
    ),
    materials: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Write the materials there, too, a .matcap file each."),
    ] = None,
    overwrite: ReplaceOption = False,
    quiet: QuietOption = False,
) -> None:
    """Draw materials out of nothing and show them under a flash.

    Each is near a random one of the photographs that the prior learnt from, or near the one given
    with --like. They are materials like any other: synth, relight, export, view and blend take
    them.
    """
    from functools import partial

    from matcap.field.header import provenance_says
    from matcap.field.plane import check_seed
    from matcap.files.mark import check_replaceable
    from matcap.files.picture import check_picture_path, write_picture
    from matcap.files.staging import check_writable, staged
    from matcap.space.prior.sample import sample_sheet

    check_picture_path(out)
    check_seed(seed + count - 1)
    files = [out]
    if materials is not None:
        files += [materials / f"{_called(like)}_{seed + i}.matcap" for i in range(count)]
    check_replaceable(
        files,
        _MARK,
        inputs=[file for file in (like, prior) if file is not None],
        overwrite=overwrite,
        own=partial(provenance_says, "drawn"),
    )
    draw = drawing(prior, like, spread)
    if materials is not None:
        check_writable(materials, 4_000_000 * count)
    drawn = [draw(seed + index) for index in range(count)]
    write_picture(sample_sheet(drawn, seed), out, _MARK)
    written = [out]
    if materials is not None:
        with staged(materials) as stage:
            for material in drawn:
                material.save(stage / f"{material.name}.matcap")
                written.append(materials / f"{material.name}.matcap")
    if not quiet:
        for path in written:
            typer.echo(f"wrote {path}", err=True)


def _called(like: Path | None) -> str:
    """What drawn materials are called, before their seed."""
    from matcap.files.names import kept_plain

    return "drawn" if like is None else f"like_{kept_plain(like.stem)}"


def drawing(
    prior: Path | None, like: Path | None, spread: float | None
) -> Callable[[int], Material]:
    """Materials by their seed, near a photograph where one is given."""
    from functools import partial

    from matcap.photo.load import load_photo
    from matcap.space.prior.anchors import SPREAD
    from matcap.space.prior.store import DETAIL, load_prior

    space = load_prior(prior)
    share = SPREAD if spread is None else spread
    if like is None:
        return partial(space.draw, spread=share)
    place = space.place(load_photo(like, long_side=DETAIL, noise=False))
    return partial(space.draw, near=place, spread=share, name=_called(like))
