"""`matcap-lab bench repetition`: does a field by example repeat, and how large are its copies?

1. *Correlation*: the largest autocorrelation at shifts longer than a copied patch, and for
   reference the cross-correlation of two seeds: chance and a lattice's periodicity contribute to
   both.
2. *Copies*: connected texels that are neighbours in the exemplar form a patch; the share of texels
   in patches of each size.
3. *Diversity*: mean difference of two seeds, texel by texel, over that of random pairs of the
   exemplar's texels: 0 for equal maps, 1 for independent ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
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
from matcap.statistics.lattice import find_lattice
from matcap_lab.bench.methods import true_exemplar
from matcap_lab.experiment.results import Value
from matcap_lab.experiment.runner import Configuration, Experiment
from matcap_lab.simulate.specimen import EXAMPLES

ABOUT = (
    "With itself, of two seeds: largest correlation of roughness at shifts of more than 128 texels "
    "(matcap_lab/bench/repetition.py); below n, larger: share of texels in verbatim copies of that "
    "size, texels; diversity: difference of two seeds, 1 for unrelated maps."
)
NEAR = 128  # texels: twice the side of the patches that a field is initialised with
SIZES = (16, 256, 1024, 4096, 16384, 65536)  # texels of a patch, upper ends of the classes
_SEEDS = (1, 2)
_ROUGHNESS = 4  # among the stacked maps
_EXEMPLAR = (1024, 768)  # texels of a simulated one
_COPIED = 1024  # texels a side of the map whose copies are counted

MapArray = NDArray[np.float32]


def example_of(material: str) -> Example:
    """The exemplar of a .matcap file, or the true maps of a simulated material of that name.

    Raises:
        MatcapError: the file has none.
    """
    if material.endswith(".matcap"):
        exemplified = read_exemplified(Path(material))
        if exemplified is None:
            raise MatcapError.at(material, "there is no exemplar in it", REMEDY)
        return exemplified.example
    exemplar = true_exemplar(material, *_EXEMPLAR)
    maps = torch.from_numpy(exemplar.stacked())
    lattice = find_lattice(maps, torch.ones(maps.shape[1:], dtype=torch.bool))
    return Example.of(exemplar, lattice.waves)


def repetition_experiment(
    materials: Sequence[str], size: int
) -> Experiment[Example, list[MapArray]]:
    """Fields of two seeds, `size` texels a side.

    Materials are simulated ones by name, all by default, or .matcap files.
    """

    def read(example: Example, _seed: int) -> list[MapArray]:
        return [example.maps(seed, Rectangle(0, 0, size, size), None) for seed in _SEEDS]

    return Experiment(
        "repetition",
        {Path(material).stem: partial(example_of, material) for material in materials or EXAMPLES},
        {f"{size} x {size} texels": Configuration(read)},
        (correlations, copied, diversity_of_seeds),
        settings=[(m, Path(m).stat().st_mtime_ns) for m in materials if Path(m).is_file()],
    )


def correlations(_example: Example, maps: list[MapArray]) -> Mapping[str, Value]:
    """Largest autocorrelation of roughness, and largest cross-correlation of two seeds."""
    first, second = (one[_ROUGHNESS] for one in maps)
    return {"with itself": correlation(first, first), "of two seeds": correlation(first, second)}


def copied(example: Example, _maps: list[MapArray]) -> Mapping[str, Value]:
    """Shares of texels in verbatim copies, by their size."""
    places = example.places(_SEEDS[0], Rectangle(0, 0, _COPIED, _COPIED), None)
    names = [*(f"below {size}" for size in SIZES), "larger"]
    return dict(zip(names, copies(places), strict=True))


def diversity_of_seeds(example: Example, maps: list[MapArray]) -> Mapping[str, Value]:
    """Mean difference of two seeds over that of random pairs of texels."""
    texels = example.exemplar.stacked().reshape(len(maps[0]), -1)
    drawn = np.random.default_rng(_SEEDS[0]).permutation(texels.shape[1])
    unrelated = _rms_difference(texels, texels[:, drawn])
    return {"diversity": float((_rms_difference(*maps) / unrelated).mean())}


def correlation(first: MapArray, second: MapArray) -> float:
    """Largest correlation of two square maps at shifts of more than NEAR texels along x or y."""
    size = len(first)
    spectra = [np.fft.rfft2((one - one.mean()) / one.std()) for one in (first, second)]
    shifted = np.fft.irfft2(spectra[0] * spectra[1].conj(), s=first.shape) / first.size
    lag = np.minimum(np.arange(size), size - np.arange(size))
    far = np.maximum(lag[:, None], lag[None, :]) > NEAR
    return float(shifted[far].max())


def copies(places: NDArray[np.int16]) -> tuple[float, ...]:
    """Share of texels in patches below each of SIZES, and in larger ones.

    `places` (H, W, 2) are x, y of each texel's source in the exemplar.
    """
    rows, columns = places.shape[:2]
    wide = places.astype(np.int32)
    # Texels are at even rows and columns of this picture, links between neighbours at odd ones.
    links = np.zeros((2 * rows - 1, 2 * columns - 1), np.uint8)
    links[::2, ::2] = 1
    links[::2, 1::2] = (np.diff(wide, axis=1) == [1, 0]).all(-1)
    links[1::2, ::2] = (np.diff(wide, axis=0) == [0, 1]).all(-1)
    _, labels = cv2.connectedComponents(links, connectivity=4, ltype=cv2.CV_32S)
    counts = np.bincount(labels[::2, ::2].ravel())
    shares = np.bincount(np.searchsorted(SIZES, counts, "right"), counts, len(SIZES) + 1)
    return tuple((shares / (rows * columns)).tolist())


def _rms_difference(first: MapArray, second: MapArray) -> NDArray[np.float64]:
    """Root mean square difference of each of the stacked maps (6, ...), RGB as one."""
    planes = [np.abs(a - b).mean(dtype=np.float64) for a, b in zip(first, second, strict=True)]
    starts = np.cumsum([0, *CHANNELS.values()])[:-1]
    return np.maximum(np.add.reduceat(planes, starts), 1e-9)
