"""The pack: all photographs a prior is trained on, and their metadata, in one safetensors file.

Pictures are JPEGs (sRGB), long side along x. Each has its coarse fit, contrast, plane waves and, if
simulated, the true tilt. Reading it needs only torch, numpy, cv2 and safetensors, so that training
runs without matcap's other dependencies; corpus.py builds it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.errors import MatcapError
from matcap.files.srgb import srgb_decode
from matcap.files.tensors import write_tensors
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.geometry import FlashSetup
from matcap.photo.photo import Photo
from matcap.statistics.lattice import Wave
from matcap_lab.train.trainer import read_tensors

VERSION = 1
_FORMAT = "matcap-pack"
HELD_OUT = 12  # materials, of the real ones
WAVE_DETAIL = 1024  # texels across, the unit of the waves' frequencies

_COARSE = 16  # diffuse 3, specular, roughness, fov, offset 3, tilt 2, intensity 3, vignetting, rest
_CLIPPED = 254  # of 255: where a developed picture has reached its clip level
_REMEDY = "build it again with `matcap-lab prior corpus`"


@dataclass(frozen=True)
class Entry:
    """One photograph of the pack."""

    name: str
    """Name of its file, or of the simulated material."""
    material: str
    """Photographs of one material share it."""
    simulated: bool
    """Made by matcap_lab.simulate."""
    jpeg: bytes
    """The encoded picture."""
    coarse: CoarseFit
    """The photograph's coarse fit."""
    contrast: Tensor
    """(3,) log contrast (space/prior/base.py)."""
    waves: tuple[Wave, ...]
    """Frequencies of its lattice, at WAVE_DETAIL texels across."""
    tilt: tuple[float, float] | None = None
    """The true (tilt_x, tilt_y) in radians, or None where unknown."""

    def photo(self) -> Photo:
        """The photograph, decoded."""
        return decode(self.jpeg, self.name, self.coarse.setup.fov)


def decode(jpeg: bytes, name: str, fov: float) -> Photo:
    """A developed (sRGB) picture as a scene-linear Photo, its long side along x."""
    code = read_code(jpeg, name)[..., ::-1]
    turned = code.shape[0] > code.shape[1]
    code = np.ascontiguousarray(np.rot90(code) if turned else code)
    return Photo(
        pixels=_LINEAR[code],
        clipped=np.asarray((code >= _CLIPPED).any(axis=-1)),
        fov=fov,
        fov_source="assumed",
        radiometric=False,
        name=name,
        original_size=(code.shape[1], code.shape[0]),
        turned=turned,
    )


def read_code(data: bytes, name: str) -> NDArray[np.uint8]:
    """(H, W, 3) BGR code values of an encoded picture.

    Raises:
        MatcapError: it cannot be read.
    """
    try:
        code = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:  # what an empty file is to it
        code = None
    if code is None:
        raise MatcapError.at(name, "the picture cannot be read", "leave it out")
    return np.asarray(code, np.uint8)


def encode(code: NDArray[np.uint8], quality: int) -> bytes:
    """A JPEG of (H, W, 3) BGR code values."""
    return cv2.imencode(".jpg", code, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def linear_of(code: NDArray[np.uint8]) -> Tensor:
    """(3, H, W) scene-linear float32 of (H, W, 3) BGR code values."""
    return torch.from_numpy(np.ascontiguousarray(_LINEAR[code[..., ::-1]].transpose(2, 0, 1)))


# Linear light of each 8-bit code value.
_LINEAR = srgb_decode(np.arange(256) / 255.0).astype(np.float32)


def held_out(materials: Sequence[str]) -> frozenset[str]:
    """Held-out materials: the first HELD_OUT by SHA-256 of their names.

    The choice is independent of the pictures and was fixed before any training.
    """
    ordered = sorted(set(materials), key=lambda m: hashlib.sha256(m.encode()).hexdigest())
    return frozenset(ordered[:HELD_OUT])


def first_of_each(entries: Sequence[Entry]) -> list[Entry]:
    """The first photograph of every material."""
    first: dict[str, Entry] = {}
    for entry in entries:
        first.setdefault(entry.material, entry)
    return list(first.values())


@dataclass(frozen=True)
class Pack:
    """Photographs to train on and to report on."""

    entries: tuple[Entry, ...]

    @property
    def reserved(self) -> frozenset[str]:
        """Names of the held-out materials."""
        return held_out([e.material for e in self.entries if not e.simulated])

    @property
    def training(self) -> tuple[Entry, ...]:
        """Photographs for training: all but those of held-out materials."""
        return tuple(e for e in self.entries if e.simulated or e.material not in self.reserved)

    @property
    def reporting(self) -> tuple[Entry, ...]:
        """Real photographs of the held-out materials."""
        return tuple(e for e in self.entries if not e.simulated and e.material in self.reserved)

    def save(self, path: Path) -> None:
        """Write the pack atomically."""
        jpegs = [np.frombuffer(e.jpeg, np.uint8) for e in self.entries]
        tensors = {
            "jpeg": torch.from_numpy(np.concatenate(jpegs).copy()),
            "length": torch.tensor([len(j) for j in jpegs]),
            "coarse": torch.stack([_to_row(e.coarse) for e in self.entries]),
            "contrast": torch.stack([e.contrast.float() for e in self.entries]),
            "waves": torch.stack([_to_waves(e.waves) for e in self.entries]),
            "tilt": torch.tensor(
                [e.tilt or (float("nan"),) * 2 for e in self.entries], dtype=torch.float64
            ),
        }
        names = [[e.name, e.material, e.simulated] for e in self.entries]
        metadata = {"format": _FORMAT, "version": str(VERSION), "names": json.dumps(names)}
        write_tensors(path, tensors, metadata)

    @staticmethod
    def load(path: Path) -> Pack:
        """Read a pack.

        Raises:
            MatcapError: the file is missing, no pack, or of another version.
        """
        metadata, tensors = read_tensors(path, (_FORMAT, VERSION), "pack", _REMEDY)
        names = json.loads(metadata["names"])
        ends = tensors["length"].cumsum(0).tolist()
        data = tensors["jpeg"].numpy()
        entries = []
        for index, (name, material, simulated) in enumerate(names):
            tilt = tensors["tilt"][index].tolist()
            entries.append(
                Entry(
                    name=name,
                    material=material,
                    simulated=simulated,
                    jpeg=data[ends[index] - int(tensors["length"][index]) : ends[index]].tobytes(),
                    coarse=_from_row(tensors["coarse"][index].tolist()),
                    contrast=tensors["contrast"][index],
                    waves=tuple(
                        Wave(fx, fy)
                        for fx, fy in tensors["waves"][index].tolist()
                        if fx == fx  # NaN marks an absent wave
                    ),
                    tilt=(tilt[0], tilt[1]) if tilt[0] == tilt[0] else None,
                )
            )
        return Pack(tuple(entries))


def _to_row(coarse: CoarseFit) -> Tensor:
    setup = coarse.setup
    values = [
        *coarse.diffuse, coarse.specular, coarse.roughness, setup.fov, *setup.offset, *setup.tilt,
        *setup.intensity, setup.vignetting, coarse.residual,
    ]  # fmt: skip
    assert len(values) == _COARSE
    return torch.tensor(values, dtype=torch.float64)


def _from_row(row: list[float]) -> CoarseFit:
    return CoarseFit(
        diffuse=(row[0], row[1], row[2]),
        specular=row[3],
        roughness=row[4],
        setup=FlashSetup(
            fov=row[5],
            offset=(row[6], row[7], row[8]),
            tilt=(row[9], row[10]),
            intensity=(row[11], row[12], row[13]),
            vignetting=row[14],
        ),
        residual=row[15],
    )


def _to_waves(waves: tuple[Wave, ...]) -> Tensor:
    table = torch.full((2, 2), float("nan"), dtype=torch.float64)
    for index, wave in enumerate(waves):
        table[index] = torch.tensor(wave, dtype=torch.float64)
    return table
