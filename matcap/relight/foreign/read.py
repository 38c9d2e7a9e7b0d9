"""Map sets of other programs as a texture to relight.

- Metallic workflow: diffuse = base (1 - metallic), F0 = 0.04 (1 - metallic) + base metallic.
- Specular workflow (specular and gloss without metallic): the specular map is F0.
- Height maps have no unit: they are scaled to fit the normal map's slopes by least squares. Without
  a height map the normal map is integrated (brdf/integrate.py).
- A set is two plane units wide, unless it is matcap's export, whose sidecar states the size.

names.py recognises files, channels.py reads them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from matcap.brdf.heights import check_heights
from matcap.brdf.integrate import integrate_periodic
from matcap.brdf.stated import NormalStyle
from matcap.relight.foreign.channels import DIELECTRIC, SetChannels, read_channels
from matcap.relight.foreign.normals import gradient
from matcap.relight.texture import Texture
from matcap.relight.vectors import Array

_LEVEL = 0.08  # F0 of specular level 1 [burley2012]
# Height range over width, assumed without a normal map.
_ASSUMED_RELIEF = 0.02
_METALS = frozenset(
    ("metal", "steel", "iron", "gold", "silver", "copper", "brass", "bronze", "chrome", "aluminium",
     "aluminum", "titanium", "zinc", "tin")
)  # fmt: skip
_FLAT = 1e-6  # relative range below which a height map is flat


@dataclass(frozen=True)
class Foreign:
    """A map set read for relighting."""

    texture: Texture
    """The material."""
    notes: tuple[str, ...]
    """What was guessed or not used, a sentence each."""


def read_foreign(folder: str | Path, *, normal: NormalStyle | None = None) -> Foreign:
    """Read a map set.

    Args:
        normal: direction of the normal map's green where no name states it: "gl" up, "dx" down.

    Raises:
        MatcapError: as read_channels and check_heights.
    """
    channels = read_channels(folder, normal=normal)
    notes = list(channels.notes)
    roughness = channels.roughness
    if roughness is None:
        roughness = np.full((1, *channels.shape), 0.5, dtype=np.float32)
        notes.append("no roughness map: 0.5 everywhere")
    diffuse, specular = _reflectance(channels, notes)
    height, slopes = _relief(channels, notes)
    check_heights(height, str(folder))
    maps = (diffuse, specular, roughness, height, slopes)
    a, b, c, d, e = (np.ascontiguousarray(one, dtype=np.float32) for one in maps)
    texture = Texture(a, b, c, d, e, channels.texel, channels.periodic)
    return Foreign(texture, tuple(notes))


def metallic_of(base: Array, metallic: Array, dielectric: Array | float = DIELECTRIC) -> Array:
    """(6, H, W) diffuse albedo and F0 of base colour (3, H, W) and metallic (1, H, W)."""
    specular = dielectric * (1.0 - metallic) + base * metallic
    return np.concatenate([base * (1.0 - metallic), specular])


def _reflectance(channels: SetChannels, notes: list[str]) -> tuple[Array, Array]:
    """(3, H, W) diffuse albedo and (1 or 3, H, W) F0."""
    base, metallic, specular = channels.base, channels.metallic, channels.specular
    stated = channels.exact or ("gloss" in channels.files and metallic is None)
    if specular is not None and stated:
        if not channels.exact:
            notes.append(f"{channels.files['specular']} is read as F0, since the set has gloss")
        if channels.conserving:
            base = base * (1.0 - specular.max(axis=0, keepdims=True))
        grey = np.ptp(specular, axis=0).max() < 1e-6
        return base, specular[:1] if grey else specular
    if specular is not None:
        notes.append(f"not used: {channels.files['specular']} (F0 of dielectrics is 0.04)")
    plain = channels.dielectric if channels.level is None else _LEVEL * channels.level
    if metallic is None:
        if _METALS & set(re.findall("[a-z]+", channels.files["base"].lower())):
            notes.append("no metallic map: read as dielectric, though its name is a metal's")
        metallic = np.zeros((1, *channels.shape), dtype=np.float32)
    both = metallic_of(base, metallic, plain)
    return both[:3], both[3:] if metallic.any() else both[3:4]


def _relief(channels: SetChannels, notes: list[str]) -> tuple[Array, Array]:
    """(1, H, W) heights and (2, H, W) slopes of the shading normal."""
    height, slopes, texel = channels.height, channels.slopes, channels.texel
    if height is not None and np.ptp(height) <= _FLAT * max(1.0, float(np.abs(height).max())):
        notes.append(f"the height map is flat ({channels.files['height']})")
        height = np.zeros_like(height)
        return height, np.zeros((2, *channels.shape), np.float32) if slopes is None else slopes
    if height is not None and channels.exact:
        return height, gradient(height, texel) if slopes is None else slopes
    if height is not None and slopes is not None:
        return height * _scale(height, slopes, texel, notes), slopes
    if height is not None:
        span = 1.0 if channels.whole else float(np.ptp(height))
        height = height * np.float32(_ASSUMED_RELIEF * 2.0 / span)
        notes.append(
            f"no normal map: the heights are assumed to span {_ASSUMED_RELIEF:g} of the width"
        )
        return height, gradient(height, texel)
    if slopes is not None:
        notes.append("no height map: the normal map was integrated")
        return integrate_periodic(slopes, texel), slopes
    notes.append("neither normal nor height map: the surface is flat")
    return np.zeros((1, *channels.shape), np.float32), np.zeros((2, *channels.shape), np.float32)


def _scale(height: Array, slopes: Array, texel: float, notes: list[str]) -> np.float32:
    """Factor on a height map that fits its slopes to the normal map's by least squares."""
    own = gradient(height, texel)
    power = float((own * own).sum())
    scale = float((own * slopes).sum()) / power if power > 0.0 else 0.0
    if scale <= 0.0:
        notes.append("the height map contradicts the normal map and is not used")
        return np.float32(0.0)
    notes.append(f"height scaled by {scale:.3g} to fit the normal map")
    return np.float32(scale)
