"""Options of `matcap export`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from matcap.files import settings as values
from matcap.files.settings import CheckedSettings, Size, setting

Depth = Literal["8", "16", "half", "float"]
Container = Literal["png", "jpg", "exr"]
NormalMaps = Literal["gl", "dx", "both"]  # +Y up, +Y down, or a file of each
Workflow = Literal["metallic", "specular"]
CONTAINERS: dict[Container, tuple[Depth, ...]] = {
    "png": ("8", "16"),
    "jpg": ("8",),
    "exr": ("half", "float"),
}
_LARGEST = 65_536  # texels a side


@dataclass(frozen=True)
class ExportArea(CheckedSettings):
    """Rectangle of a material to export."""

    size: Size | None = setting(
        None, metavar="WxH", parse=values.sides(_LARGEST), otherwise="1024x1024"
    )
    """Texels read from a material, 2048x1024 or 2K, at most 65536 a side; they repeat without a
    seam where both are multiples of 16."""
    seed: int | None = setting(None, metavar="SEED", parse=values.seed, otherwise="0")
    """Seed of the material's realisation."""
    tile: Literal["piece"] | None = setting(None, words=("piece",), otherwise="a part of the field")
    """piece: the photographed rectangle itself, made to repeat, at about its own size."""


@dataclass(frozen=True)
class ExportOptions(CheckedSettings):
    """Options that override a target's defaults; `maps` and `normal` are of presets alone."""

    maps: Sequence[str] = ()
    """Textures of a preset to write, by their names in its table; empty is all."""
    normal: NormalMaps | None = setting(None, words=("gl", "dx", "both"), otherwise="the target's")
    """Normals of textures: +Y up (gl), down (dx), or a file of each (both)."""
    bits: Depth | None = setting(
        None, words=("8", "16", "half", "float"), otherwise="the target's", group="Output"
    )
    """Depth of all textures: PNG of 8 or 16 bits, EXR of half or float."""
    workflow: Workflow | None = setting(
        None,
        words=("metallic", "specular"),
        otherwise="the one with the smaller residual; unreal: metallic",
        group="Output",
    )
    """Metallic or specular workflow, for targets that have both."""
    container: Container | None = setting(
        None,
        option="format",
        words=("png", "jpg", "exr"),
        otherwise="png, or exr for floats",
        group="Output",
    )
    """Format of the textures; with jpg, heights are PNG."""
    unit: float | None = setting(
        None,
        least=1e-6,
        most=1e9,
        metavar="MM",
        otherwise="the material's measured size",
        group="Output",
    )
    """Length of a plane unit (half the photograph's long side) in millimetres, for physical sizes
    and heights."""
