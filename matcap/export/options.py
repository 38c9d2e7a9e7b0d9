"""Options of `matcap export`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from matcap.files import values
from matcap.files.settings import check_settings, setting

if TYPE_CHECKING:
    from matcap.export.formats import Container, Depth
    from matcap.export.presets import NormalMaps
    from matcap.export.textures import Workflow
    from matcap.files.values import Size

_LARGEST = 65_536  # texels a side


def _listed(text: str | Sequence[str]) -> tuple[str, ...]:
    names = text.split(",") if isinstance(text, str) else text
    return tuple(one.strip() for one in names)


@dataclass(frozen=True)
class ExportArea:
    """What is read from a material.

    Raises:
        UsageError: a word that there is not.
    """

    size: Size | None = setting(
        None, metavar="WxH", parse=values.sides(_LARGEST), otherwise="1024x1024"
    )
    """Texels read from a material, 2048x1024 or 2K, at most 65536 a side; they repeat without a
    seam where both are multiples of 16."""
    udim: Size | None = setting(None, metavar="CxR", parse=values.size)
    """A texture set of C columns (at most 10) and R rows (at most 900) of a material, each tile of
    --size."""
    seed: int | None = setting(None, metavar="SEED", parse=values.seed, otherwise="0")
    """Which piece is read from a material."""
    tile: Literal["piece"] | None = setting(None, words=("piece",), otherwise="a part of the field")
    """piece: the photographed piece itself, made to repeat, at about its own size."""

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class ExportOptions:
    """What the user wants otherwise than the target; the first three for presets alone.

    Raises:
        UsageError: a word or a number that there is not.
    """

    pattern: str | None = setting(None, option="name", metavar="PATTERN")
    """Of a preset's files: the fields {stem}, {map}, {res} and {format} as they are."""
    maps: Sequence[str] = setting((), metavar="A,B", parse=_listed)
    """Of a preset, only these, such as diffuse,roughness."""
    normal: NormalMaps | None = setting(
        None, words=("gl", "dx", "both"), otherwise="what the preset wants"
    )
    """Of a preset: normals with +Y up (gl), down (dx), or both."""
    bits: Depth | None = setting(
        None, words=("8", "16", "half", "float"), otherwise="what suits the target"
    )
    """Of all textures: PNGs of 8 or 16 bits, EXR files of half or float."""
    workflow: Workflow | None = setting(
        None,
        words=("metallic", "specular"),
        otherwise="what comes nearest; of unreal metallic",
    )
    """The target's metallic or specular workflow, where it has both."""
    container: Container | None = setting(
        None,
        option="format",
        words=("png", "jpg", "webp", "exr", "tx"),
        otherwise="png or exr, as the bits are",
    )
    """Of the textures' files; heights stay PNGs where it is jpg or webp."""
    tiled: bool = setting(False)
    """EXR files in tiles, with mipmaps."""
    unit: float | None = setting(
        None, least=1e-6, most=1e9, metavar="MM", otherwise="what the material knows"
    )
    """Millimetres of a plane unit, half the photograph's long side: sizes and heights are then
    real."""

    def __post_init__(self) -> None:
        check_settings(self)
