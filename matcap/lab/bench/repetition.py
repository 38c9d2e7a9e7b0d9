"""Whether a field by example shows its tricks: does it repeat, and how large are its copies?

1. *Correlation* of a map with itself, the largest at any shift of more than a piece's length,
   beside that of the maps of two seeds, which share no random number: what a finite map correlates
   by chance, and what a lattice does by right, is in both.
2. *Copies*: texels that continue each other in the exemplar are one piece; the share of texels in
   pieces of each size.
3. *Diversity*: how far two seeds are apart, texel by texel, as a share of what texels of the
   exemplar are that are drawn at random: 0 for the same map, 1 for maps without relation.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from matcap.brdf.maps import CHANNELS
from matcap.errors import MatcapError
from matcap.example.example import Example
from matcap.example.stored import read_exemplified
from matcap.field.header import REMEDY
from matcap.field.plane import Rectangle
from matcap.lab.bench.by_example import true_exemplar
from matcap.statistics.lattice import find_lattice

NEAR = 128  # texels: twice what a piece is begun with
SIZES = (16, 256, 1024, 4096, 16384, 65536)  # texels of a piece, upper ends of the classes
_SEEDS = (1, 2)
_ROUGHNESS = 4  # among the stacked maps
_EXEMPLAR = (1024, 768)  # texels of a simulated one
_COPIED = 1024  # texels a side of the map whose copies are counted

MapArray = NDArray[np.float32]


@dataclass(frozen=True)
class Repetition:
    """Of one field.

    Attributes:
        name: of the material.
        own: largest correlation of roughness with itself, farther than NEAR.
        other: of the roughness of two seeds.
        copies: share of texels in pieces below each of SIZES, and of larger ones.
        diversity: of two seeds.
    """

    name: str
    own: float
    other: float
    copies: tuple[float, ...]
    diversity: float


def example_of(material: str) -> Example:
    """The exemplar of a .matcap file, or the true maps of a simulated material of that name.

    Raises:
        MatcapError: the file has none.
    """
    if material.endswith(".matcap"):
        held = read_exemplified(Path(material))
        if held is None:
            raise MatcapError("there is no exemplar in it", where=material, remedy=REMEDY)
        return held.example
    exemplar = true_exemplar(material, *_EXEMPLAR)
    maps = torch.from_numpy(exemplar.stacked())
    lattice = find_lattice(maps, torch.ones(maps.shape[1:], dtype=torch.bool))
    return Example.of(exemplar, tuple((wave.fx, wave.fy) for wave in lattice.waves))


def measure(name: str, example: Example, size: int) -> Repetition:
    """Read two seeds of so many texels a side, and compare."""
    maps = [example.maps(seed, Rectangle(0, 0, size, size), None) for seed in _SEEDS]
    first, second = (one[_ROUGHNESS] for one in maps)
    places = example.places(_SEEDS[0], Rectangle(0, 0, _COPIED, _COPIED), None)
    texels = example.exemplar.stacked().reshape(len(maps[0]), -1)
    drawn = np.random.default_rng(_SEEDS[0]).permutation(texels.shape[1])
    unrelated = _apart(texels, texels[:, drawn])
    return Repetition(
        name,
        correlation(first, first),
        correlation(first, second),
        copies(places),
        float((_apart(*maps) / unrelated).mean()),
    )


def correlation(first: MapArray, second: MapArray) -> float:
    """The largest of two square maps at shifts of more than NEAR texels along x or y."""
    size = len(first)
    spectra = [np.fft.rfft2((one - one.mean()) / one.std()) for one in (first, second)]
    shifted = np.fft.irfft2(spectra[0] * spectra[1].conj(), s=first.shape) / first.size
    lag = np.minimum(np.arange(size), size - np.arange(size))
    far = np.maximum(lag[:, None], lag[None, :]) > NEAR
    return float(shifted[far].max())


def copies(places: NDArray[np.int16]) -> tuple[float, ...]:
    """Share of texels in pieces below each of SIZES, and of larger ones.

    Args:
        places: (H, W, 2) x, y of the exemplar that every texel shows.
    """
    rows, columns = places.shape[:2]
    wide = places.astype(np.int32)
    # Texels lie at even places of a picture that has their bonds between them.
    bonds = np.zeros((2 * rows - 1, 2 * columns - 1), np.uint8)
    bonds[::2, ::2] = 1
    bonds[::2, 1::2] = (np.diff(wide, axis=1) == [1, 0]).all(-1)
    bonds[1::2, ::2] = (np.diff(wide, axis=0) == [0, 1]).all(-1)
    _, labels = cv2.connectedComponents(bonds, connectivity=4, ltype=cv2.CV_32S)
    counts = np.bincount(labels[::2, ::2].ravel())
    shares = np.bincount(np.searchsorted(SIZES, counts, "right"), counts, len(SIZES) + 1)
    return tuple((shares / (rows * columns)).tolist())


def markdown(found: list[Repetition], size: int, command: str) -> str:
    """The measurements as a section of documentation."""
    below = [f"below {size}" for size in SIZES]
    names = ["material", "with itself", "of two seeds", *below, "larger", "diversity"]
    lines = [
        f"Measured by `{command}`, on {size} x {size} texels.",
        "",
        f"| {' | '.join(names)} |",
        f"|---|{'---:|' * (len(names) - 1)}",
        *(
            f"| {one.name} | {one.own:.3f} | {one.other:.3f} | "
            f"{' | '.join(f'{share:.0%}' for share in one.copies)} | {one.diversity:.2f} |"
            for one in found
        ),
    ]
    return "\n".join(lines) + "\n"


def _apart(first: MapArray, second: MapArray) -> NDArray[np.float64]:
    """Mean distance of each of the stacked maps (6, ...), colours together."""
    planes = [np.abs(a - b).mean(dtype=np.float64) for a, b in zip(first, second, strict=True)]
    starts = np.cumsum([0, *CHANNELS.values()])[:-1]
    return np.maximum(np.add.reduceat(planes, starts), 1e-9)
