"""More of a material, as files: what `matcap synth` does, for Python too.

Without PyTorch until it is needed: a material's file with an exemplar needs none, and it takes
longer to start than such a map takes to make.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from matcap.brdf.adjust import KEY, NONE, Adjustments
from matcap.brdf.folder import MapSetInfo
from matcap.errors import UsageError
from matcap.field.plane import Period, Rectangle, check_seed
from matcap.synth.adjusted import adjusted_source
from matcap.synth.fields import OpenedField, Wanted, open_blend, open_field, open_repeating
from matcap.synth.request import Files, Request, Work
from matcap.synth.stream import write_field

if TYPE_CHECKING:
    from matcap.field.device import DeviceName
    from matcap.field.material import Material
    from matcap.field.source import Generator
    from matcap.synth.precision import ChosenPrecision, Precision

Axes = Literal["both", "x", "y"]
# Or the photographed piece itself, made to repeat along both, at about its own size.
Repeating = Axes | Literal["piece"]


@dataclass(frozen=True)
class Growth:
    """What a material grows into.

    Attributes:
        material: the other one, or its file.
        mask: a grey picture; where it is white the other one is.
        over: the rectangle that the mask is stretched over, or None for all that is written.
    """

    material: Material | Path
    mask: Path
    over: Rectangle | None = None


@dataclass(frozen=True)
class SynthRequest:
    """What is wanted of a material.

    Attributes:
        material: to make more of, or its file.
        area: of the one map set, or of a texture set's left top tile, in texels of the field.
        seed: which realisation, in [-2^63, 2^63).
        name: of the files; the material's unless given.
        files: how maps are stored.
        tile: the axes along which the whole of it repeats exactly, or None; "piece" for the
            photographed piece itself, made to repeat, which has a size of its own: `area` is not
            read then, nor is the seed.
        growth: what it grows into, or None.
        precision: of the decoder: "fp32", "bf16", or "auto" for as much bfloat16 as no eye can
            see.
        device: of the decoder: "cpu", "cuda", or "auto" for CUDA where it is there.
        generator: "example" or "decoder"; None: by example where there is an exemplar.
        adjust: what is changed of the maps; the sidecar's provenance tells it.
        variety: from 0, the photographed piece itself repeated, to 1, of many small pieces; None
            for the material's own. The sidecar's provenance tells it.
    """

    material: Material | Path
    area: Rectangle
    seed: int = 0
    name: str = ""
    files: Files = Files()
    tile: Repeating | None = None
    growth: Growth | None = None
    precision: Precision = "fp32"
    device: DeviceName = "auto"
    generator: Generator | None = None
    adjust: Adjustments = NONE
    variety: float | None = None


def synthesise(
    asked: SynthRequest,
    folder: str | Path,
    work: Work | None = None,
    told: Callable[[ChosenPrecision], None] = lambda choice: None,
) -> Path:
    """Write it into a folder, all of its files or none; returns the JSON file.

    Args:
        asked: what.
        folder: where to; made when missing.
        work: who does it, and with whom to tell how far it is.
        told: called with a decoder's precision, once it is chosen.

    Raises:
        UsageError: a seed, size or repeat out of range, a device that is not there.
        MatcapError: a mask that cannot be read, precisions too rough, and what write_field raises.

    Example:
        synthesise(SynthRequest(material, Rectangle(0, 0, 4096, 256), seed=7), "more")
    """
    work = work or Work()
    check_seed(asked.seed)
    # A cluster's machines may have no CUDA device, and their blocks must be alike.
    device = "cpu" if work.scheduler and asked.device == "auto" else asked.device
    if asked.tile == "piece":
        _check_piece(asked)
        found = open_repeating(asked.material, asked.generator)
        width, height = found.source.period or (None, None)
        asked = replace(asked, area=Rectangle(0, 0, width or 0, height or 0))
        return _written(asked, found, folder, work)
    whole = asked.files.whole(asked.area)
    period = _period(asked.tile, whole)
    wanted = Wanted(asked.seed, period, asked.generator, asked.precision, device, asked.variety)
    growth = asked.growth
    if growth is None:
        found = open_field(asked.material, wanted)
    else:
        over = growth.over or whole
        found = open_blend(asked.material, growth.material, growth.mask, over, wanted)
    if found.choice is not None:
        told(found.choice)
    return _written(asked, found, folder, work)


def _written(asked: SynthRequest, found: OpenedField, folder: str | Path, work: Work) -> Path:
    """Write what was found; returns the JSON file."""
    origin = (asked.area.x, asked.area.y)
    provenance = found.provenance
    if asked.adjust.changes:
        provenance = provenance | {KEY: asked.adjust.text}
    if asked.variety is not None:
        provenance = provenance | {"variety": asked.variety}
    info = MapSetInfo(asked.name or found.name, asked.seed, origin, provenance)
    source = adjusted_source(found.source, asked.adjust)
    return write_field(Request(source, asked.area, info, asked.files), folder, work)


def _check_piece(asked: SynthRequest) -> None:
    """Raise UsageError for what cannot be asked of the photographed piece itself."""
    refused = {
        "--udim": asked.files.udim is not None,
        "--blend": asked.growth is not None,
        "--variety": asked.variety is not None,
        "--seed": asked.seed != 0,
    }
    for option, given in refused.items():
        if given:
            raise UsageError(
                "the photographed piece is one, of a size of its own",
                where=f"{option} with --tile piece",
                remedy=f"leave {option} out, or let the field repeat, with --tile alone",
            )


def _period(tile: Axes | None, area: Rectangle) -> Period | None:
    """What repeats: the whole of what is written."""
    if tile is None:
        return None
    return None if tile == "y" else area.width, None if tile == "x" else area.height
