"""The pack: photographs that a prior is trained on, in one file; how it is built and shown.

Pictures are JPEGs (sRGB), long side along x. Each has its coarse fit, contrast, plane waves and, if
simulated, the true tilt. Reading it needs only torch, numpy, cv2 and safetensors, so that training
runs without matcap's other dependencies.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap.field.material import Material
from matcap.files.color import srgb_decode, srgb_encode
from matcap.files.output import Output
from matcap.files.tensors import write_tensors
from matcap.flash.coarse.fit import CoarseFit, fit_coarse
from matcap.flash.geometry import FlashSetup, plane_points
from matcap.flash.light import render_flash
from matcap.flash.rectify import read_plane
from matcap.photo.exif import phone_fov
from matcap.photo.photo import Photo
from matcap.space.tuning.match import log_contrast
from matcap.statistics.lattice import Wave, find_lattice
from matcap_lab.measures.style import srgb_encode_tensor
from matcap_lab.simulate.kinds import RandomKind, random_kind
from matcap_lab.simulate.photograph import PhoneCamera, expose, take
from matcap_lab.simulate.varied import RandomMaterial, random_material
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
    """(3,) log contrast (space/prior/store.py)."""
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


# Builds the pack: real photographs of a folder, and simulated ones of an endless stream.
#
# Simulated photographs show procedural materials (matcap_lab.simulate) under random fields of view,
# flash offsets, tilts and vignetting, with sensor noise, clipping and JPEG, as a phone would.

PICTURES = (".jpg", ".jpeg", ".png")
QUALITY = 85  # of the pack's JPEGs
LONG_SIDE = 1024  # of the pack's pictures
_MOST_TILT = math.radians(15.0)
_KIND_SHARE = 0.6  # of the simulated photographs, as in the inverse network's training
_PACK_TILT = math.radians(4.0)  # deviation, of photographs meant to be taken from straight above
_SIMULATED = "simulated_"  # names of simulated photographs begin so, and end with their seed


def build(
    folder: Path | None,
    simulated: int,
    seed: int = 0,
    on_progress: Callable[[str], None] = lambda line: None,
) -> tuple[Pack, list[tuple[str, str]]]:
    """Pack the photographs of a folder and as many simulated ones.

    A picture's material is its name up to the first underscore. Also returns the (name, reason) of
    pictures left out because they cannot be read.

    Raises:
        MatcapError: the folder is missing, or no picture could be used.
    """
    entries: list[Entry] = []
    skipped: list[tuple[str, str]] = []
    for path in _pictures(folder):
        try:
            entries.append(read(path))
            on_progress(f"{path.name}: packed")
        except MatcapError as error:
            skipped.append((path.name, error.what))
            on_progress(f"{path.name}: left out, {error.what}")
    for index in range(simulated):
        entries.append(simulate(seed * 1_000_003 + index))
        on_progress(f"{entries[-1].name}: packed")
    if not entries:
        where = str(folder) if folder else "corpus"
        raise MatcapError.at(where, "no picture could be used", "give a folder of JPEGs or PNGs")
    return Pack(tuple(entries)), skipped


def _pictures(folder: Path | None) -> Iterator[Path]:
    if folder is None:
        return
    if not folder.is_dir():
        raise MatcapError.at(folder, "there is no such folder", "check its name")
    yield from (p for p in sorted(folder.iterdir()) if p.suffix.lower() in PICTURES)


def read(path: Path) -> Entry:
    """Pack one real photograph.

    Raises:
        MatcapError: it cannot be read.
    """
    code = read_code(path.read_bytes(), str(path))
    if code.shape[0] > code.shape[1]:
        code = np.ascontiguousarray(np.rot90(code))
    if code.shape[1] > LONG_SIDE:
        size = (LONG_SIDE, round(LONG_SIDE * code.shape[0] / code.shape[1]))
        code = np.asarray(cv2.resize(code, size, interpolation=cv2.INTER_AREA), np.uint8)
    return entry(path.name, path.stem.split("_")[0], code, phone_fov(*code.shape[:2]))


def simulate(seed: int) -> Entry:
    """Pack one simulated photograph; a seed is a material and a shot of it."""
    code, camera, setup = simulated_code(seed)
    name = f"{_SIMULATED}{seed}"
    return entry(name, name, code, camera.fov, tilt=setup.tilt)


def true_piece(entry: Entry, side: int) -> MapSet | None:
    """True maps, `side` texels a side at WAVE_DETAIL, of a simulated photograph's material.

    None for a real photograph. They are another realisation than the photographed one, which
    suffices for statistics.

    Raises:
        MatcapError: the pack was built by another version, whose seeds were other materials.
    """
    if not entry.simulated:
        return None
    seed = entry.name.removeprefix(_SIMULATED)
    scene = scene_of(int(seed)) if seed.isdecimal() else None
    if scene is None or scene[2].tilt != entry.tilt:
        raise MatcapError.at(
            entry.name,
            "this simulated photograph is of another version, and its true maps are not known",
            "build the pack again with `matcap-lab prior corpus`, or train with relit = 0",
        )
    return scene[0].realise(side, side, int(seed), 2.0 / WAVE_DETAIL)


def simulated_code(seed: int) -> tuple[NDArray[np.uint8], PhoneCamera, FlashSetup]:
    """A simulated photograph (H, W, 3) uint8 BGR, the camera and the flash; see simulate."""
    material, camera, setup = scene_of(seed)
    shot = take(lambda w, h, texel: material.realise(w, h, seed, texel), camera, setup)
    return srgb_bytes(expose(shot, seed)), camera, setup


def scene_of(seed: int) -> tuple[RandomMaterial | RandomKind, PhoneCamera, FlashSetup]:
    """Material, camera and camera pose with flash, drawn from a seed."""
    rng = np.random.default_rng([20212, seed])
    material = material_of(seed, rng)
    camera = PhoneCamera(
        width=LONG_SIDE,
        height=LONG_SIDE * 3 // 4,
        focal_length=int(rng.integers(24, 36)),
        full_well=float(rng.uniform(3000.0, 12000.0)),
        supersampling=1,
        blur=float(rng.uniform(0.4, 1.0)),
        brightness=float(rng.uniform(0.15, 0.32)),
        clipped=float(rng.uniform(0.0, 0.04)),
    )
    return material, camera, random_setup(rng)


def material_of(seed: int, rng: np.random.Generator) -> RandomMaterial | RandomKind:
    """A material of a kind (cells, weaves, planks, ...), or a pattern drawn from `rng`."""
    which = np.random.default_rng([20213, seed])
    return random_kind(which) if which.random() < _KIND_SHARE else random_material(rng)


def random_setup(rng: np.random.Generator) -> FlashSetup:
    """Random phone above a material: flash 1 to 3 cm from the lens, distance 15 to 30 cm."""
    angle, reach = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.03, 0.14)
    tilt = rng.normal(0.0, _PACK_TILT, 2).clip(-_MOST_TILT, _MOST_TILT)
    return FlashSetup(
        offset=(reach * math.cos(angle), reach * math.sin(angle), 0.0),
        tilt=(float(tilt[0]), float(tilt[1])),
        vignetting=float(rng.uniform(0.0, 0.6)),
    )


def srgb_bytes(linear: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 BGR of linear RGB in [0, 1]."""
    code = srgb_encode(linear.clip(0.0, 1.0))
    return np.ascontiguousarray(np.round(code * 255.0).astype(np.uint8)[..., ::-1])


def entry(
    name: str, material: str, code: np.ndarray, fov: float, tilt: tuple[float, float] | None = None
) -> Entry:
    """Pack a developed picture (H, W, 3) uint8 BGR, W >= H."""
    jpeg = encode(code, QUALITY)
    photo = decode(jpeg, name, fov)
    coarse = fit_coarse(photo)
    plane = read_plane(photo, coarse.setup, WAVE_DETAIL)
    return Entry(
        name=name,
        material=material,
        simulated=tilt is not None,
        jpeg=jpeg,
        coarse=coarse,
        contrast=log_contrast(plane.linear, plane.valid),
        waves=find_lattice(plane.encoded(), plane.valid).waves,
        tilt=tilt,
    )


# Comparable pictures of photographs and materials: central crops at one exposure.

SIZE = 256  # texels a side of what is compared
_MEAN = 0.25  # radiance that every picture is brought to
_SHOWN = 192  # texels a side of a picture on a sheet
_QUALITY = 85


def middle(entry: Entry) -> Tensor:
    """(3, SIZE, SIZE) sRGB, the middle of a photograph of the pack."""
    return _exposed(_cut(torch.from_numpy(entry.photo().pixels.transpose(2, 0, 1).copy())))


def simulated_middle(seed: int) -> Tensor:
    """(3, SIZE, SIZE) sRGB, the middle of a simulated photograph."""
    return _exposed(_cut(linear_of(simulated_code(seed)[0])))


def lit(material: Material) -> Tensor:
    """lit_maps() of a material, under its own flash."""
    return lit_maps(material.maps(SIZE, SIZE), material.setup)


def lit_maps(maps: MapSet, setup: FlashSetup) -> Tensor:
    """(3, SIZE, SIZE) sRGB of maps lying in the middle of a photograph, under a flash."""
    width, height = LONG_SIDE, LONG_SIDE * 3 // 4
    x, y = (width - SIZE) // 2, (height - SIZE) // 2
    points = plane_points(x, y, SIZE, SIZE, (width, height), dtype=torch.float32)
    with torch.inference_mode():
        return _exposed(render_flash(maps, setup, points))


def write_grid(pictures: Sequence[Tensor], columns: int, path: Path) -> None:
    """Write a JPEG grid of sRGB pictures (3, H, W) of one size, `columns` wide.

    Raises:
        MatcapError: the file cannot be written.
    """
    padded = [*pictures, *[torch.zeros_like(pictures[0])] * (-len(pictures) % columns)]
    rows = [torch.cat(padded[i : i + columns], dim=2) for i in range(0, len(padded), columns)]
    code = torch.cat(rows, dim=1).permute(1, 2, 0).numpy()[..., ::-1]
    share = _SHOWN / pictures[0].shape[-2]
    small = cv2.resize(code, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    stored = np.ascontiguousarray((small * 255.0).round().astype(np.uint8))
    with Output.file(path) as file:
        file.write_bytes(encode(stored, _QUALITY))


def _cut(linear: Tensor) -> Tensor:
    """Central crop of (3, H, W), of at most SIZE texels a side."""
    y, x = (max(0, side - SIZE) // 2 for side in linear.shape[-2:])
    return linear[:, y : y + SIZE, x : x + SIZE]


def _exposed(linear: Tensor) -> Tensor:
    """SRGB of radiance (3, H, W), scaled to the common mean."""
    gain = _MEAN / linear.mean().clamp_min(1e-6)
    return srgb_encode_tensor((linear * gain).clamp(0.0, 1.0))
