"""Map sets made by artists and scanners, as materials that can be photographed.

One folder per material: `basecolor.jpg` (sRGB), `normal.png` (8 bit, +Y up), `roughness.png` (8
bit, perceptual), and `metallic.png` where some of it is metal; all of one size, and tileable. A
remark in the folders' common `manifest.json` marks bare metals without `metallic.png`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from matcap.brdf.integrate import integrate_periodic
from matcap.brdf.maps import HEIGHT, SURFACE, MapSet
from matcap.errors import MatcapError
from matcap.relight.foreign.channels import read_channels
from matcap.relight.foreign.read import metallic_of

_SPAN = 2.0  # plane units of a set's width: as much as a photograph spans

_PLASTIC = (0.7549, 0.5698)  # Roberts's R2 sequence: any few of its points lie far apart

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class MapSetMaterial:
    """A tileable material."""

    name: str
    """Name of its folder."""
    tile: Floats
    """(6, h, w) diffuse, specular, roughness and height, 8 where some of it is metal; height in
    texels of the tile."""
    texel_size: float
    """A texel's side on the tile, plane units."""

    def realise(self, width: int, height: int, seed: int, texel_size: float) -> MapSet:
        """A rectangle of the repeated tile, float64 (C, height, width).

        Neighbouring seeds lie far apart on the tile. Texels, of a size in plane units, are
        interpolated if finer than the tile's, else averaged. A finer texel size over the same
        extent gives the same crop at a higher resolution.
        """
        tile = _shrunk(self.tile, texel_size / self.texel_size)
        rows, columns = tile.shape[1:]
        step = texel_size / self.texel_size * columns / self.tile.shape[2]
        x = seed * _PLASTIC[0] * columns + _from_middle(width) * step - 0.5
        y = seed * _PLASTIC[1] * rows + _from_middle(height) * step - 0.5
        planes = _sampled(_sampled(tile, y, 1), x, 2).astype(np.float64)
        planes[SURFACE] = planes[SURFACE].clip(0.0, 1.0)
        planes[HEIGHT] *= self.texel_size
        return MapSet.from_stacked(torch.from_numpy(planes), texel_size)


def read_map_set(folder: Path) -> MapSetMaterial:
    """Read a folder.

    F0 has three channels if any of it is metal. Height is integrated from the normals: a height
    map's scale would be unknown.

    Raises:
        MatcapError: a map is missing, or cannot be read.
    """
    surface, slopes = read_surface(folder)
    diffuse, specular, roughness, metallic = np.split(surface, (3, 6, 7))
    specular = specular if metallic.any() else specular[:1]
    stacked = np.concatenate([diffuse, specular, roughness, integrate_periodic(slopes)])
    return MapSetMaterial(folder.name, stacked.astype(np.float32), _SPAN / stacked.shape[2])


def read_surface(folder: Path) -> tuple[Floats, Floats]:
    """(8, H, W) diffuse albedo, F0, roughness and share that is metal of a folder; its slopes.

    The slopes (2, H, W) are those of the normals, y upwards. Without a metallic map, all of a bare
    metal is metal.

    Raises:
        MatcapError: base colour, normal or roughness is missing, or cannot be read.
    """
    channels = read_channels(folder, normal="gl")
    missing = [k for k in ("roughness", "slopes") if getattr(channels, k) is None]
    if missing:
        raise MatcapError.at(
            folder,
            f"there is no map of {missing[0]} that can be read",
            "give a folder with basecolor, normal and roughness",
        )
    assert channels.roughness is not None and channels.slopes is not None
    metallic = channels.metallic
    if metallic is None:
        bare = folder.name in bare_metals(folder.parent / "manifest.json")
        metallic = np.full_like(channels.roughness, float(bare))
    both = metallic_of(channels.base, metallic)
    return np.concatenate([both, channels.roughness, metallic]), channels.slopes


def map_set_folders(folder: Path) -> list[Path]:
    """The folders in a folder that hold a map set, in order of their names."""
    return sorted(path.parent for path in folder.glob("*/basecolor.jpg"))


def bare_metals(manifest: Path) -> frozenset[str]:
    """Names of sets that are all metal but lack a metallic map."""
    if not manifest.is_file():
        return frozenset()
    entries = json.loads(manifest.read_text())
    return frozenset(one["name"] for one in entries if "bare metal" in one.get("remarks", ""))


def _shrunk(tile: Floats, step: float) -> Floats:
    """The tile area-averaged to texels of `step` of its own; unchanged if step <= 1."""
    if step <= 1.0:
        return tile
    size = tuple(max(1, round(side / step)) for side in tile.shape[:0:-1])
    return np.stack([cv2.resize(plane, size, interpolation=cv2.INTER_AREA) for plane in tile])


def _from_middle(count: int) -> NDArray[np.float64]:
    """(count,) texel centres relative to the middle, texels."""
    places: NDArray[np.float64] = np.arange(count, dtype=np.float64)
    return places + (1.0 - count) / 2.0


def _sampled(tile: Floats, places: NDArray[np.float64], axis: int) -> Floats:
    """A periodic tile at places along an axis, by Catmull-Rom cubics [catmull1974].

    OpenCV's cubics overestimate slopes by up to a half.
    """
    shape = tuple(-1 if a == axis else 1 for a in range(tile.ndim))
    first = np.floor(places)
    t = (places - first).astype(np.float32)
    weights = (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )
    taps = (
        weight.reshape(shape) * tile.take(first.astype(np.int64) + index, axis, mode="wrap")
        for index, weight in enumerate(weights, start=-1)
    )
    return np.asarray(sum(taps), np.float32)
