"""More of a material, as files: what `matcap synth` does, for Python too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Literal

from matcap.brdf.folder import MapSetInfo
from matcap.model.device import DeviceName, find_device
from matcap.model.material import Material
from matcap.model.patch import Period, Rectangle
from matcap.model.source import Source, check_seed, material_source
from matcap.synth.blend import blend_source
from matcap.synth.mask import read_mask
from matcap.synth.precision import Choice, Precision, choose
from matcap.synth.request import Files, Request, Work
from matcap.synth.stream import write_field

Axes = Literal["both", "x", "y"]


@dataclass(frozen=True)
class Growth:
    """What a material grows into.

    Attributes:
        material: the other one.
        mask: a grey picture; where it is white the other one is.
        over: the rectangle that the mask is stretched over, or None for all that is written.
    """

    material: Material
    mask: Path
    over: Rectangle | None = None


@dataclass(frozen=True)
class SynthRequest:
    """What is wanted of a material.

    Attributes:
        material: to make more of.
        area: of the one map set, or of a texture set's left top tile, in texels of the field.
        seed: which realisation, in [-2^63, 2^63).
        name: of the files; the material's unless given.
        files: how maps are stored.
        tile: the axes along which the whole of it repeats exactly, or None.
        growth: what it grows into, or None.
        precision: "fp32", "bf16", or "auto" for as much bfloat16 as no eye can see.
        device: "cpu", "cuda", or "auto" for CUDA where it is there.
    """

    material: Material
    area: Rectangle
    seed: int = 0
    name: str = ""
    files: Files = Files()
    tile: Axes | None = None
    growth: Growth | None = None
    precision: Precision = "fp32"
    device: DeviceName = "auto"


def synthesise(
    asked: SynthRequest,
    folder: str | Path,
    work: Work | None = None,
    told: Callable[[Choice], None] = lambda choice: None,
) -> Path:
    """Write it into a folder, all of its files or none; returns the JSON file.

    Args:
        asked: what.
        folder: where to; made when missing.
        work: who does it, and with whom to tell how far it is.
        told: called with the precision, once it is chosen.

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
    source, provenance = _source(asked, device)
    choice = choose(source, asked.precision)
    told(choice)
    origin = (asked.area.x, asked.area.y)
    info = MapSetInfo(asked.name or asked.material.name, asked.seed, origin, provenance)
    return write_field(Request(choice.source, asked.area, info, asked.files), folder, work)


def _source(asked: SynthRequest, device: DeviceName) -> tuple[Source, dict[str, object]]:
    """What blocks are read from, and how it was made."""
    place = find_device(device)
    material, growth, whole = asked.material, asked.growth, asked.files.whole(asked.area)
    period = _period(asked.tile, whole)
    provenance = dict(material.provenance)
    if growth is None:
        return material_source(material, asked.seed, period, place), provenance
    over = growth.over or whole
    spread = read_mask(growth.mask, over, period)
    source = blend_source(material, growth.material, spread, asked.seed, period, place)
    names = [material.name, growth.material.name]
    return source, provenance | {"blend": names, "mask_over": list(astuple(over))}


def _period(tile: Axes | None, area: Rectangle) -> Period | None:
    """What repeats: the whole of what is written."""
    if tile is None:
        return None
    return None if tile == "y" else area.width, None if tile == "x" else area.height
