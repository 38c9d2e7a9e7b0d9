"""Adjustments of maps on output (relief, roughness, saturation, tint, brightness).

The material itself is unchanged. One text, shared by `synth`, `export`, `relight` and the page, and
stored in sidecars:

    relief=1.3,roughness=-0.1,saturation=0.8,brightness=1.1,tint=#ffe8d0

Keys:
    relief: factor on heights, and thus on slopes.
    roughness: added to perceptual roughness, clipped to [0, 1].
    saturation: factor on the difference between a colour and grey of its luminance, of diffuse
        albedo and of coloured F0; 0 is grey.
    tint: colour that multiplies diffuse albedo, scaled to luminance 1.
    brightness: factor on diffuse albedo, clipped to [0, 1].

Applied in this order: saturation, tint, brightness. NumPy only: reading a field by example needs no
PyTorch.
"""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import UsageError
from matcap.files.color import LUMINANCE, srgb_decode
from matcap.files.names import read_document

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet

Planes = NDArray[np.float32]

WHERE = "--adjust"
KEY = "adjust"  # in sidecars
RANGES = {
    "relief": (0.0, 10.0),
    "roughness": (-1.0, 1.0),
    "saturation": (0.0, 4.0),
    "brightness": (0.0, 8.0),
}
_WHITE = "#ffffff"
_LUMINANCE = np.array(LUMINANCE, np.float32)
_LONGEST = 10_000  # largest sidecar, in bytes


@dataclass(frozen=True)
class Adjustments:
    """Values of all adjustments; by default none changes anything.

    Raises:
        UsageError: a value out of range.
    """

    relief: float = 1.0
    """Factor on heights, 0 to 10."""
    roughness: float = 0.0
    """Added to perceptual roughness, -1 to 1."""
    saturation: float = 1.0
    """Factor on the difference from grey, 0 to 4."""
    brightness: float = 1.0
    """Factor on diffuse albedo, 0 to 8."""
    tint: str = _WHITE
    """sRGB colour that multiplies diffuse albedo, "#rrggbb"."""

    def __post_init__(self) -> None:
        for name, (least, most) in RANGES.items():
            value = getattr(self, name)
            if not least <= value <= most:
                raise UsageError.at(
                    WHERE, f"{name} is {value:g}", f"give a number from {least:g} to {most:g}"
                )
        if not re.fullmatch(r"#[0-9a-fA-F]{6}", self.tint) or self.tint == "#000000":
            raise UsageError.at(
                WHERE,
                f"tint is '{self.tint[:20]}'",
                "give a colour other than black, such as #ffe8d0",
            )

    @property
    def changes(self) -> bool:
        """Whether any value differs from its default."""
        return bool(self.text)

    @property
    def text(self) -> str:
        """The text that parse_adjustments reads; "" for none."""
        changed = (
            (name, value) for name, value in asdict(self).items() if value != getattr(NONE, name)
        )
        return ",".join(
            f"{name}={value if isinstance(value, str) else f'{value:g}'}" for name, value in changed
        )

    @property
    def file_part(self) -> str:
        """The text in a form fit for file names."""
        return self.text.replace("=", "").replace(",", "_")

    @property
    def mixing(self) -> NDArray[np.float32]:
        """(3, 3) matrix of saturation alone, linear Rec.709."""
        grey = np.tile(_LUMINANCE, (3, 1))
        return grey + np.float32(self.saturation) * (np.eye(3, dtype=np.float32) - grey)

    @property
    def colour(self) -> NDArray[np.float32]:
        """(3, 3) matrix of saturation, tint and brightness on diffuse albedo, linear Rec.709."""
        saturated = self.mixing
        linear = srgb_decode(
            np.array([int(self.tint[at : at + 2], 16) for at in (1, 3, 5)], np.float64) / 255.0
        )
        tint = linear / float(linear @ _LUMINANCE)
        return (self.brightness * tint[:, None] * saturated).astype(np.float32)


NONE = Adjustments()


def parse_adjustments(text: str | None) -> Adjustments:
    """Parse a text, or the text in a sidecar (a file name ending in .json).

    Raises:
        UsageError: an unknown or repeated name, a value that is no number or out of range; a
            sidecar without adjustments.
    """
    if not text:
        return NONE
    if text.lower().endswith(".json"):
        text = _read(Path(text))
    given: dict[str, Any] = {}
    for part in text.split(",") if text else []:
        name, equals, value = (one.strip() for one in part.partition("="))
        known = [field.name for field in fields(Adjustments)]
        if not equals or name not in known:
            raise UsageError.at(
                WHERE,
                f"'{part.strip()[:40]}' is not an adjustment",
                f"give name=value with a name of {', '.join(known)}",
            )
        if name in given:
            raise UsageError.at(WHERE, f"{name} is given twice", "leave one out")
        given[name] = value.lower() if name == "tint" else _number(name, value)
    return Adjustments(**given)


def adjusted_planes(planes: Planes, adjustments: Adjustments) -> Planes:
    """Adjust stacked maps, (6 or 8, H, W), or with their normal (9 or 11, H, W).

    Returns `planes` itself where nothing changes.
    """
    if not adjustments.changes:
        return planes
    adjusted = planes.copy()
    with_normal = len(planes) > 8
    coloured = len(planes) in (8, 11)
    roughness, height = (4, 5) if not coloured else (6, 7)
    if not np.array_equal(adjustments.colour, NONE.colour):
        adjusted[:3] = np.einsum("ij,jhw->ihw", adjustments.colour, planes[:3]).clip(0.0, 1.0)
    if coloured and adjustments.saturation != 1.0:
        adjusted[3:6] = np.einsum("ij,jhw->ihw", adjustments.mixing, planes[3:6]).clip(0.0, 1.0)
    if adjustments.roughness:
        adjusted[roughness] = (planes[roughness] + np.float32(adjustments.roughness)).clip(0.0, 1.0)
    if adjustments.relief != 1.0:
        factor = np.float32(adjustments.relief)
        adjusted[height] *= factor
        if with_normal:
            adjusted[-3:-1] *= factor
            adjusted[-3:] /= np.sqrt(np.square(adjusted[-3:]).sum(axis=0))
    return adjusted


def adjusted(maps: MapSet, adjustments: Adjustments) -> MapSet:
    """Adjust maps without batch dimensions; returns `maps` itself where nothing changes."""
    if not adjustments.changes:
        return maps
    import torch

    stacked = maps.stacked() if maps.painted is None else torch.cat([maps.stacked(), maps.painted])
    planes = adjusted_planes(stacked.detach().cpu().float().numpy(), adjustments)
    count = stacked.shape[-3] - (0 if maps.painted is None else 3)
    changed = type(maps).from_stacked(torch.from_numpy(planes[:count]), maps.texel_size)
    painted = None if maps.painted is None else torch.from_numpy(planes[count:])
    return replace(changed, periodic=maps.periodic, painted=painted)


def _number(name: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise UsageError.at(WHERE, f"{name} is '{value[:20]}'", "give a number")
    return number


def _read(path: Path) -> str:
    short = path.is_file() and path.stat().st_size <= _LONGEST
    document = (read_document(path) if short else None) or {}
    provenance = document.get("provenance")
    stated = provenance.get(KEY) if isinstance(provenance, dict) else None
    text = document.get(KEY, stated)
    if not isinstance(text, str):
        raise UsageError.at(path, "this file has no adjustments", "give relief=1.3 or the like")
    return text
