"""Map sets made by artists and scanners, as materials that can be photographed.

A folder a material: `basecolor.jpg` (sRGB), `normal.png` (8 bit, +Y up), `roughness.png` (8 bit,
perceptual), and `metallic.png` where some of it is metal; all of one size, and tileable. Of a bare
metal without that, a remark in the `manifest.json` beside the folders says so.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from matcap.brdf.maps import HEIGHT, SURFACE, MapSet
from matcap.errors import MatcapError
from matcap.files.srgb import srgb_decode_tensor

SPAN = 2.0  # plane units of a set's width, by default: as much as a photograph spans

_DIELECTRIC = 0.04  # F0 of what is no metal
_STEEPEST = 0.05  # least z of a normal: 8 bits tell no slope beyond 20
_PLASTIC = (0.7549, 0.5698)  # Roberts's R2 sequence: any few of its points lie far apart

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class MapSetMaterial:
    """A tileable material.

    Attributes:
        name: of its folder.
        tile: (6, h, w) diffuse, specular, roughness and height, 8 where some of it is metal; height
            in texels of the tile.
        texel_size: of the tile, in plane units.
    """

    name: str
    tile: Floats
    texel_size: float

    def piece(self, seed: int) -> Callable[[int, int, float], MapSet]:
        """The material around another place; those of seeds near each other lie far apart."""

        def realise(width: int, height: int, texel_size: float) -> MapSet:
            return self.realise(width, height, seed, texel_size)

        return realise

    def realise(self, width: int, height: int, seed: int, texel_size: float) -> MapSet:
        """A rectangle of the repeated tile, float64 (C, height, width).

        Finer than the tile its texels are interpolated, coarser they are averaged. A finer texel
        size over the same extent shows the same piece.

        Args:
            width: texels.
            height: texels.
            seed: says where on the tile the middle of the rectangle lies.
            texel_size: a texel's side in plane units.
        """
        tile = _shrunk(self.tile, texel_size / self.texel_size)
        rows, columns = tile.shape[1:]
        step = texel_size / self.texel_size * columns / self.tile.shape[2]
        x = seed * _PLASTIC[0] * columns + _from_middle(width) * step - 0.5
        y = seed * _PLASTIC[1] * rows + _from_middle(height) * step - 0.5
        found = _sampled(_sampled(tile, y, 1), x, 2).astype(np.float64)
        found[SURFACE] = found[SURFACE].clip(0.0, 1.0)
        found[HEIGHT] *= self.texel_size
        return MapSet.from_stacked(torch.from_numpy(found), texel_size)


def read_map_set(folder: Path, span: float = SPAN) -> MapSetMaterial:
    """Read a folder.

    Diffuse albedo is basecolor (1 - metallic); F0 is 0.04 (1 - metallic) + basecolor metallic, of
    three channels where any of it is metal. Relief is the surface whose slopes come nearest to the
    normal's.

    Args:
        folder: of one material.
        span: width of the tile, in plane units.

    Raises:
        MatcapError: a map is missing, cannot be read or has another size.
    """
    colour = torch.from_numpy(_read(folder / "basecolor.jpg")).permute(2, 0, 1)
    base = srgb_decode_tensor(colour).numpy()
    rows, columns = base.shape[1:]
    roughness = _read(folder / "roughness.png").mean(2)
    normal = _read(folder / "normal.png") * 2.0 - 1.0
    is_metal = (folder / "metallic.png").is_file()
    bare = float(not is_metal and folder.name in bare_metals(folder.parent / "manifest.json"))
    metal = _read(folder / "metallic.png").mean(2) if is_metal else np.full_like(roughness, bare)
    if not roughness.shape == normal.shape[:2] == metal.shape == (rows, columns):
        raise MatcapError("the maps of this set have different sizes", where=str(folder))
    steep = np.maximum(normal[..., 2], _STEEPEST)
    height = _integrated(-normal[..., 0] / steep, -normal[..., 1] / steep)
    specular = _DIELECTRIC * (1.0 - metal) + base * metal
    if not metal.any():
        specular = specular[:1]
    gloss = np.stack([roughness, height])
    stacked = np.concatenate([base * (1.0 - metal), specular, gloss])
    return MapSetMaterial(folder.name, stacked.astype(np.float32), span / columns)


def map_set_folders(folder: Path) -> list[Path]:
    """The folders in a folder that hold a map set, in order of their names."""
    return sorted(path.parent for path in folder.glob("*/basecolor.jpg"))


def bare_metals(manifest: Path) -> frozenset[str]:
    """Sets that are metal all over though they have no map that says so."""
    if not manifest.is_file():
        return frozenset()
    told = json.loads(manifest.read_text())
    return frozenset(one["name"] for one in told if "bare metal" in one.get("remarks", ""))


def _read(path: Path) -> Floats:
    """(H, W, 3) float32 in [0, 1], red first."""
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise MatcapError("there is no map that can be read", where=str(path))
    return np.ascontiguousarray(picture[..., ::-1], np.float32) / np.float32(255.0)


def _integrated(across: Floats, up: Floats) -> Floats:
    """(H, W) the repeating surface, in texels, of slopes (Frankot and Chellappa 1988)."""
    rows, columns = across.shape
    wx = 2.0 * np.pi * np.fft.fftfreq(columns)[None, :]
    wy = -2.0 * np.pi * np.fft.fftfreq(rows)[:, None]
    squared = wx * wx + wy * wy
    squared[0, 0] = 1.0
    spectrum = -1j * (wx * np.fft.fft2(across) + wy * np.fft.fft2(up)) / squared
    spectrum[0, 0] = 0.0
    return np.fft.ifft2(spectrum).real.astype(np.float32)


def _shrunk(tile: Floats, step: float) -> Floats:
    """The tile with texels no finer than `step` of its own, averaged."""
    if step <= 1.0:
        return tile
    size = tuple(max(1, round(side / step)) for side in tile.shape[:0:-1])
    return np.stack([cv2.resize(plane, size, interpolation=cv2.INTER_AREA) for plane in tile])


def _from_middle(count: int) -> NDArray[np.float64]:
    """(count,) places of texels' centres."""
    places: NDArray[np.float64] = np.arange(count, dtype=np.float64)
    return places + (1.0 - count) / 2.0


def _sampled(tile: Floats, places: NDArray[np.float64], axis: int) -> Floats:
    """A repeating tile at places along an axis, by cubics through its texels that keep its slopes.

    Catmull and Rom 1974; OpenCV's cubics are steeper by up to a half.
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
