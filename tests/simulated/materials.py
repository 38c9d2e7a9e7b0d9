"""Six plain stationary materials, each a pure function of place and seed.

Relief and colour are made of value noise and Voronoi cells [worley1996]; lengths are in plane
units. They are no more than what a test needs: something bumpy, woven, polished, rusted, rough and
tiled.
"""

import zlib
from collections.abc import Callable

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from simulated.photographs import Piece

from matcap.brdf.maps import MapSet
from matcap.example.exemplar import Exemplar

Raster = NDArray[np.float64]
_LATTICE = 256  # random numbers a side, after which they repeat


class Canvas:
    """Texels of a rectangle around the origin, and random fields of a seed on them."""

    def __init__(self, width: int, height: int, texel: float, seed: int) -> None:
        self.texel, self.seed = texel, seed
        self.x = np.broadcast_to((np.arange(width) + 0.5 - width / 2.0) * texel, (height, width))
        down = (np.arange(height) + 0.5 - height / 2.0) * texel
        self.y = np.broadcast_to(down[:, None], (height, width))

    def random(self, label: str) -> np.random.Generator:
        """Numbers of a label's own."""
        return np.random.default_rng([self.seed, zlib.crc32(label.encode())])

    def noise(self, label: str, size: float, *, octaves: int = 3, gain: float = 0.5) -> Raster:
        """Noise of about unit deviation: octaves of random numbers `size` apart, and finer."""
        total, power = np.zeros(self.x.shape), 0.0
        for octave in range(octaves):
            lattice = self.random(f"{label} {octave}").standard_normal((_LATTICE, _LATTICE))
            # Octaves finer than two texels are seen as their mean.
            if size < 2.0 * self.texel:
                break
            places = [np.mod(axis / size, _LATTICE) for axis in (self.x, self.y)]
            padded = np.pad(lattice.astype(np.float32), 2, mode="wrap")
            u, v = ((place + 2.0).astype(np.float32) for place in places)
            total += gain**octave * cv2.remap(padded, u, v, cv2.INTER_CUBIC)
            power, size = power + 0.5 * gain ** (2 * octave), size / 2.0
        return total / np.sqrt(max(power, 1e-9))

    def cells(self, label: str, size: float) -> tuple[Raster, Raster, Raster]:
        """Distance to the nearest point, on to the second nearest, in sizes; and a number each.

        The number is in [0, 1), one for each cell.
        """
        points = self.random(label).random((3, _LATTICE, _LATTICE))
        u, v = self.x / size, self.y / size
        column, row = np.floor(u).astype(int), np.floor(v).astype(int)
        nearest = second = np.full(u.shape, np.inf)
        number = np.zeros(u.shape)
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                at_u, at_v = column + right, row + down
                du, dv, own = points[:, at_v % _LATTICE, at_u % _LATTICE]
                squared = (at_u + du - u) ** 2 + (at_v + dv - v) ** 2
                second = np.minimum(np.maximum(nearest, squared), second)
                number = np.where(squared < nearest, own, number)
                nearest = np.minimum(nearest, squared)
        return np.sqrt(nearest), np.sqrt(second) - np.sqrt(nearest), number

    def maps(
        self, diffuse: Raster, specular: Raster | float, roughness: Raster | float, height: Raster
    ) -> MapSet:
        """Fields that broadcast, clipped to their ranges, float64."""

        def stored(field: Raster | float, channels: int, low: float, high: float) -> torch.Tensor:
            full = np.broadcast_to(np.asarray(field, np.float64), (channels, *self.x.shape))
            return torch.from_numpy(np.clip(full, low, high))

        return MapSet(
            stored(diffuse, 3, 0.004, 0.95),
            stored(specular, 1, 0.02, 0.98),
            stored(roughness, 1, 0.05, 1.0),
            stored(height, 1, -np.inf, np.inf),
            self.texel,
        )


def _colour(*channels: float) -> Raster:
    return np.array(channels)[:, None, None]


def leather(at: Canvas) -> MapSet:
    """Domed pebbles parted by creases, dyed brown, varnished."""
    near, border, tone = at.cells("pebbles", 0.045)
    crease = np.exp(-((border / 0.28) ** 2))
    dye = at.noise("dye", 0.05)
    height = 0.045 * ((0.03 - 0.03 * near**2 + 0.02 * tone) * (1.0 - crease) - 0.035 * crease)
    height = height + 0.0003 * at.noise("skin", 0.012)
    diffuse = _colour(0.19, 0.07, 0.03) * np.exp(0.1 * dye - 0.5 * crease)
    return at.maps(diffuse, 0.046, 0.4 + 0.2 * crease + 0.02 * dye, height)


def cloth(at: Canvas) -> MapSet:
    """A plain weave of round threads, 13 texels apart at 1024 across."""
    spacing = 13.0 * 2.0 / 1024.0
    u, v = at.x / spacing, at.y / spacing
    u, v = u + 0.05 * at.noise("u", 0.1, octaves=1), v + 0.05 * at.noise("v", 0.1, octaves=1)
    checks = np.cos(np.pi * (np.floor(u) + np.floor(v)))
    rise = checks * np.abs(np.sin(np.pi * u) * np.sin(np.pi * v))
    across = np.where(rise > 0.0, np.mod(u, 1.0), np.mod(v, 1.0)) - 0.5
    round_thread = np.sqrt(np.maximum(0.0, 1.0 - (2.0 * across) ** 2))
    height = spacing * 0.3 * (0.4 * np.abs(rise) + 0.5 * round_thread)
    dye = at.noise("dye", 0.02)
    tone = np.exp(0.15 * dye) * (0.4 + 0.6 * round_thread)
    diffuse = np.where(rise > 0.0, _colour(0.05, 0.085, 0.165), _colour(0.105, 0.15, 0.23)) * tone
    return at.maps(diffuse, 0.04, 0.68 + 0.03 * dye, height)


def granite(at: Canvas) -> MapSet:
    """Polished: crystals of several colours, hardly any relief."""
    _, _, kind = at.cells("crystals", 0.034)
    _, _, mica = at.cells("mica", 0.018)
    palette = np.array([[0.44, 0.26, 0.2], [0.4, 0.24, 0.19], [0.48, 0.42, 0.37], [0.28] * 3])
    body = np.moveaxis(palette[(4 * kind).astype(int)], -1, 0)
    cloud = at.noise("cloud", 0.03, octaves=4, gain=0.7)
    dark = (mica < 0.12).astype(float)
    diffuse = body * np.exp(0.1 * cloud) * (1.0 - 0.85 * dark)
    height = 0.0001 * at.noise("polish", 0.03) - 0.0002 * dark
    return at.maps(diffuse, 0.043 + 0.014 * dark, 0.2 + 0.1 * dark, height)


def rust(at: Canvas) -> MapSet:
    """Steel without albedo in a rough crust of brown rust."""
    patches = at.noise("patches", 0.1, octaves=5, gain=0.6)
    crumbs = at.noise("crumbs", 0.02)
    crust = 1.0 / (1.0 + np.exp(-10.0 * (patches + 0.2 * crumbs + 0.3)))
    height = crust * (0.0015 + 0.0007 * at.noise("scale", 0.03) + 0.0003 * crumbs)
    brown = _colour(0.22, 0.09, 0.03) * np.exp(0.3 * at.noise("age", 0.08) + 0.2 * crumbs)
    diffuse = brown * crust + 0.035 * (1.0 - crust)
    specular = 0.042 + (0.5 - 0.042) * (1.0 - crust)
    return at.maps(diffuse, specular, 0.42 + 0.44 * crust + 0.02 * crumbs, height)


def plaster(at: Canvas) -> MapSet:
    """A rough white wall with fine bumps."""
    lumps, sand = at.noise("lumps", 0.08), at.noise("sand", 0.015)
    _, _, holed = at.cells("holes", 0.03)
    stain = at.noise("stain", 0.1)
    height = 0.001 * lumps + 0.0008 * sand
    pits = (holed < 0.05) * (sand > 0.5)
    diffuse = _colour(0.61, 0.56, 0.47) * np.exp(0.05 * stain + 0.05 * sand - 0.8 * pits)
    return at.maps(diffuse, 0.038, 0.82 + 0.02 * stain, height - 0.001 * pits)


def tile(at: Canvas) -> MapSet:
    """Glossy tiles, 24 across the picture, in rough, lower grout."""
    u, v = (12.0 * axis + 0.02 * at.noise(name, 0.2) for axis, name in ((at.x, "u"), (at.y, "v")))
    column, row = np.floor(u).astype(int), np.floor(v).astype(int)
    own = at.random("fired").random((2, _LATTICE, _LATTICE))
    tone, level = own[:, row % _LATTICE, column % _LATTICE] - 0.5
    inside = 0.5 - np.maximum(np.abs(u - column - 0.5), np.abs(v - row - 0.5)) - 0.04
    glazed = np.clip(0.5 + inside / 0.03, 0.0, 1.0)
    sand, mottle = at.noise("sand", 0.015), at.noise("mottle", 0.03)
    pillow = 1.0 - np.exp(-np.maximum(inside, 0.0) / 0.05)
    tiles = 0.003 * pillow + 0.001 * level + 0.0002 * mottle
    height = tiles * glazed + (0.0004 * sand - 0.0015) * (1.0 - glazed)
    glaze = _colour(0.03, 0.17, 0.2) * np.exp(0.3 * tone + 0.12 * mottle)
    grout = _colour(0.37, 0.35, 0.31) * np.exp(0.1 * sand)
    diffuse = glaze * glazed + grout * (1.0 - glazed)
    return at.maps(diffuse, 0.037 + 0.015 * glazed, 0.84 - 0.66 * glazed, height)


MATERIALS: dict[str, Callable[[Canvas], MapSet]] = {
    material.__name__: material for material in (leather, cloth, granite, rust, plaster, tile)
}


def realise(name: str, width: int, height: int, seed: int, texel: float) -> MapSet:
    """Maps of a material of a seed around the origin, float64."""
    return MATERIALS[name](Canvas(width, height, texel, seed))


def piece(name: str, seed: int = 11) -> Piece:
    """A material's piece, to be photographed."""
    return lambda width, height, texel: realise(name, width, height, seed, texel)


def true_exemplar(name: str, width: int, height: int, detail: int = 1024) -> Exemplar:
    """A material's true maps as an exemplar."""
    maps = realise(name, width, height, 11, 2.0 / detail)
    return Exemplar.certain(maps.stacked().float().numpy(), maps.texel_size)
