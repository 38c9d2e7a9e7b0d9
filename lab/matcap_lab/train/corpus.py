"""Builds the pack: real photographs of a folder, and simulated ones of an endless stream.

Simulated photographs show procedural materials (matcap_lab.simulate) under random fields of view,
flash offsets, tilts and vignetting, with sensor noise, clipping and JPEG, as a phone would.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap.files.srgb import srgb_encode
from matcap.flash.coarse.fit import fit_coarse
from matcap.flash.geometry import FlashSetup
from matcap.flash.plane import read_plane
from matcap.photo.exif import phone_fov
from matcap.space.tuning.start import log_contrast
from matcap.statistics.lattice import find_lattice
from matcap_lab.simulate.materials.kinds import RandomKind, random_kind
from matcap_lab.simulate.materials.varied import RandomMaterial, random_material
from matcap_lab.simulate.photograph import PhoneCamera, expose, take
from matcap_lab.train.pack import WAVE_DETAIL, Entry, Pack, decode, encode, read_code

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
    name: str,
    material: str,
    code: np.ndarray,
    fov: float,
    tilt: tuple[float, float] | None = None,
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
