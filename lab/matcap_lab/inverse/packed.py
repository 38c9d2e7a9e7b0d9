"""Map sets of real materials in one training file: a half-precision pyramid of each.

A set's folder holds `basecolor`, `normal`, `roughness` and, where some of it is metal, `metallic`
(../data/maps/README.md of the project). Height is integrated from the normals: a height map's scale
would be unknown. Each level halves the resolution; the slope variance that this removes is added to
alpha^2.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.integrate import integrate_periodic
from matcap.errors import MatcapError
from matcap.files.tensors import write_tensors
from matcap_lab.simulate.map_sets import read_surface
from matcap_lab.train.trainer import read_tensors

LEVELS = 3  # full, half, quarter
_ROUGHNESS = slice(6, 7)  # of a surface
# A set is held out where its name's hash leaves this remainder: one that has sets of every kind.
_EVERY, _LEFT_OUT = 5, 1
_STEEPEST = math.tan(math.radians(75.0))  # slope; steeper texels of normal maps are faults
_FORMAT = "matcap-maps"
_VERSION = 3

Picture = NDArray[np.float32]


@dataclass(frozen=True)
class PackedSet:
    """Maps of one material, tileable, level by level."""

    name: str
    """Name of its folder."""
    surface: tuple[Tensor, ...]
    """Level by level (8, H, W) float16: diffuse albedo and F0 (linear, 3 each), roughness, and the
    share that is metal."""
    height: tuple[Tensor, ...]
    """Level by level (1, H, W) float32 in texels of that level, of mean 0."""


def is_held_out(name: str) -> bool:
    """Whether a set is left out of training: a fifth, by its name alone."""
    return zlib.crc32(name.encode()) % _EVERY == _LEFT_OUT


def pack(folder: Path, out: Path) -> int:
    """Write all sets in a folder as one file; returns how many.

    The sides of their maps are multiples of 2^(LEVELS - 1).

    Raises:
        MatcapError: there is none, or one of them cannot be read.
    """
    names = sorted(path.parent.name for path in folder.glob("*/normal.*"))
    if not names:
        raise MatcapError.at(
            folder,
            "there are no map sets in this folder",
            "give a folder of folders with basecolor, normal and roughness",
        )
    tensors: dict[str, Tensor] = {}
    for name in names:
        surface, slopes = read_surface(folder / name)
        steepness = np.sqrt(np.square(slopes).sum(0, keepdims=True))
        slopes = slopes * np.minimum(1.0, _STEEPEST / np.maximum(steepness, 1e-6))
        surface, height = surface.astype(np.float32), integrate_periodic(slopes)
        for level in range(LEVELS):
            if level:
                surface, height = halved(surface, height)
            tensors[f"{name}/{level}/surface"] = torch.from_numpy(surface).half()
            tensors[f"{name}/{level}/height"] = torch.from_numpy(height)
    about = {"format": _FORMAT, "version": str(_VERSION), "names": json.dumps(names)}
    write_tensors(out, tensors, about)
    return len(names)


def halved(surface: Picture, height: Picture) -> tuple[Picture, Picture]:
    """The set at half its resolution; the slope variance removed is added to alpha^2."""
    fine = np.square(_slopes(height)).sum(0, keepdims=True)
    coarse_height = _mean(height) / 2.0
    lost = np.maximum(_mean(fine) - np.square(_slopes(coarse_height)).sum(0, keepdims=True), 0.0)
    # The mean of lobes weighted by F0 has the weighted mean of alpha^2.
    coarse = surface.copy()
    coarse[_ROUGHNESS] **= 4
    coarse = _mean(coarse)
    coarse[_ROUGHNESS] = np.minimum(coarse[_ROUGHNESS] + lost, 1.0) ** 0.25
    return coarse, coarse_height


@cache
def open_pack(path: Path) -> Mapping[str, PackedSet]:
    """All sets of a file by name; read once a process.

    Raises:
        MatcapError: it is no such file.
    """
    remedy = "make it with `matcap-lab inverse pack`"
    metadata, tensors = read_tensors(path, (_FORMAT, _VERSION), "pack of maps", remedy)

    def levels(name: str, what: str) -> tuple[Tensor, ...]:
        return tuple(tensors[f"{name}/{i}/{what}"] for i in range(LEVELS))

    names: list[str] = json.loads(metadata["names"])
    return {n: PackedSet(n, levels(n, "surface"), levels(n, "height")) for n in names}


@cache
def training_sets(path: Path) -> tuple[PackedSet, ...]:
    """The sets of a file for training."""
    return tuple(s for name, s in open_pack(path).items() if not is_held_out(name))


def held_out_sets(path: Path) -> tuple[PackedSet, ...]:
    """The held-out sets of a file."""
    return tuple(s for name, s in open_pack(path).items() if is_held_out(name))


def _slopes(height: Picture) -> Picture:
    """(2, H, W) central differences of a periodic height (1, H, W) in texels."""
    across = (np.roll(height, -1, -1) - np.roll(height, 1, -1)) / 2.0
    down = (np.roll(height, 1, -2) - np.roll(height, -1, -2)) / 2.0
    return np.concatenate([across, down])


def _mean(picture: Picture) -> Picture:
    """Means of 2 x 2 texels of (C, H, W)."""
    channels, height, width = picture.shape
    cells = picture.reshape(channels, height // 2, 2, width // 2, 2)
    return np.asarray(cells.mean((2, 4)), np.float32)
