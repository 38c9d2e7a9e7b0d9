"""Specimens: materials with known truth that captures are evaluated on, map sets among them."""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from matcap.brdf.heights import integrate_periodic, resized_height
from matcap.brdf.maps import HEIGHT, MapSet
from matcap.errors import MatcapError, UsageError
from matcap.flash.geometry import FlashSetup
from matcap.relight.foreign.names import assigned
from matcap.relight.foreign.read import ForeignMaps, metallic_of
from matcap_lab.simulate.files import PHONE, write_dng, write_jpeg
from matcap_lab.simulate.kinds import kind_of, kinds_known
from matcap_lab.simulate.named import realise
from matcap_lab.simulate.photograph import PhoneCamera, Realise, RealiseAt, Shot, take, true_maps

_PHOTOGRAPHED = 11  # seed of the piece that is photographed, where no example says one
_CONE = 43  # seed of a phone's vignetting, together with a material's name
_SETUP = FlashSetup(offset=(0.10, 0.05, 0.0), tilt=(0.02, -0.02))


@dataclass(frozen=True)
class Specimen:
    """A material whose truth is known."""

    name: str
    """The material's name."""
    material: RealiseAt
    """The material, of any seed, size and resolution."""
    seed: int = _PHOTOGRAPHED
    """Seed of the photographed realisation and of the sensor's noise."""
    setup: FlashSetup = _SETUP
    """Geometry of the photograph; the camera adds field of view and intensity."""
    shading: float = 0.0
    """Lens shading in its DNG (write_dng)."""

    @property
    def realise(self) -> Realise:
        """The photographed realisation."""
        return self.pieces(self.seed)

    def pieces(self, seed: int) -> Realise:
        """A realisation."""
        return lambda width, height, texel_size: self.material(width, height, seed, texel_size)

    def take(self, camera: PhoneCamera) -> Shot:
        """Simulate a photograph of the specimen."""
        return take(self.realise, camera, self.setup)

    def truth(self, camera: PhoneCamera) -> MapSet:
        """True maps of the plane rectangle x in [-1, 1], one texel a pixel."""
        return true_maps(self.realise, camera, self.setup)

    def path(self, out: Path, number: int | None = None, *, jpeg: bool = False) -> Path:
        """Path in a folder of its photograph, or of number `number` of several."""
        name = self.name.replace(":", "-") + ("" if number is None else f"_{number}")
        return out / f"{name}.{'jpg' if jpeg else 'dng'}"

    def write(
        self, shot: Shot, out: Path, number: int | None = None, *, jpeg: bool = False
    ) -> Path:
        """Write a simulated photograph to path(); MatcapError if that fails."""
        path, seed = self.path(out, number, jpeg=jpeg), self.seed + (number or 0)
        if jpeg:
            write_jpeg(path, shot, seed, PHONE)
        else:
            write_dng(path, shot, seed, self.shading)
        return path


def _example(
    name: str,
    seed: int,
    offset: tuple[float, float],
    tilt: tuple[float, float],
    shading: float = 0.0,
) -> Specimen:
    """A named material; the flash's offset in plane units, tilts in degrees."""
    x, y = (math.radians(degrees) for degrees in tilt)
    setup = FlashSetup(offset=(*offset, 0.0), tilt=(x, y))
    return Specimen(name, partial(realise, name), seed, setup, shading)


# The example photographs, by name.
EXAMPLES: Mapping[str, Specimen] = MappingProxyType(
    {
        specimen.name: specimen
        for specimen in (
            _example("leather", 11, (0.12, 0.05), (1.5, -2.0)),
            _example("cloth", 12, (-0.10, 0.06), (-1.0, 1.2)),
            _example("granite", 13, (0.11, -0.04), (2.2, 1.0), 0.45),
            _example("rust", 14, (0.08, 0.09), (-2.0, -1.5)),
            _example("plaster", 15, (0.13, 0.02), (1.0, 2.6)),
            _example("tile", 16, (-0.07, 0.08), (1.8, -1.0)),
        )
    }
)
# Seed of each kind's parameters; training draws it only by chance.
NUMBER = 5001
USUAL = (*EXAMPLES, "weave", "asphalt", "hammered")


def photograph(
    specimen: Specimen, camera: PhoneCamera, out: Path, *, ev: float = 0.0, jpeg: bool = False
) -> tuple[Path, Shot]:
    """Photograph a specimen into a folder: the file, and the shot with its true setup.

    The exposure is `ev` EV above the automatic one. A JPEG is developed as by a phone, under a
    flash whose cone points beside the lens's axis (`phone_cone`); a DNG has no cone.

    Raises:
        MatcapError: the folder cannot be written.
    """
    if jpeg:
        specimen = replace(specimen, setup=phone_cone(specimen.setup, specimen.name))
    shot = specimen.take(camera)
    gain = 2.0**ev
    red, green, blue = (gain * channel for channel in shot.setup.intensity)
    shot = Shot(gain * shot.linear, shot.setup.with_intensity((red, green, blue)), camera)
    return specimen.write(shot, out, jpeg=jpeg), shot


def phone_cone(setup: FlashSetup, name: str) -> FlashSetup:
    """A setup with a phone's vignetting and cone of the flash, drawn by a material's name.

    On 126 photographs of two phones (coarse fits, 2026-11-28) the corners lose 1.1 and 2.4 (log),
    around a centre 0.19 half widths above the picture's, on one phone up to 0.2 beside it.
    """
    rng = np.random.default_rng([zlib.crc32(name.encode()), _CONE])
    lost, fourth = rng.uniform(0.5, 2.5), rng.uniform(0.2, 0.8)
    across, up = rng.normal((0.0, 0.19), 0.1)
    return replace(
        setup,
        vignetting=float(lost * (1.0 - fourth)),
        vignetting_quartic=float(lost * fourth),
        vignetting_centre=(float(across), float(up)),
    )


def subjects(names: Iterable[str], sets: Path | None = None) -> list[Specimen]:
    """Subjects by name, and of every map set in a folder.

    Args:
        names: of EXAMPLES, of a kind ("weave", or "weave:7" for seed 7 of its parameters), or of a
            map set in `sets`; if empty, all sets.
        sets: folder of map sets (matcap_lab/simulate/specimen.py).

    Raises:
        UsageError: no such material.
        MatcapError: a map set that cannot be read.
    """
    folders = {folder.name: folder for folder in map_set_folders(sets)} if sets else {}
    chosen = list(names) or list(folders) or USUAL
    return [_subject(name, folders) for name in chosen]


def _subject(name: str, folders: dict[str, Path]) -> Specimen:
    if name in EXAMPLES:
        return EXAMPLES[name]
    if name in folders:
        return Specimen(name, read_map_set(folders[name]).realise)
    kind, _, number = name.partition(":")
    if kind in kinds_known() and (number.isdecimal() or not number):
        return Specimen(name, kind_of(kind, int(number or NUMBER)).realise)
    known = ", ".join([*EXAMPLES, *kinds_known(), *folders])
    raise UsageError.at(name, "there is no such material", f"choose from {known}")


# Map sets made by artists and scanners, as materials that can be photographed.
#
# One folder per material: `basecolor.jpg` (sRGB), `normal.png` (8 bit, +Y up), `roughness.png` (8
# bit, perceptual), and `metallic.png` where some of it is metal; all of one size, and tileable. A
# remark in the folders' common `manifest.json` marks bare metals without `metallic.png`.

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
        planes[:-1] = planes[:-1].clip(0.0, 1.0)
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
    maps = ForeignMaps.of(assigned(folder))
    missing = [kind for kind in ("base", "roughness", "normal") if kind not in maps.files]
    if missing:
        raise MatcapError.at(
            folder,
            f"there is no map of {missing[0]} that can be read",
            "give a folder with basecolor, normal and roughness",
        )
    base, roughness = maps.colour("base"), maps.scalar("roughness")
    slopes, metallic = maps.slopes(None, 1.0, "gl"), maps.scalar("metallic")
    assert base is not None and roughness is not None and slopes is not None
    if metallic is None:
        bare = folder.name in bare_metals(folder.parent / "manifest.json")
        metallic = np.full_like(roughness, float(bare))
    return np.concatenate([metallic_of(base, metallic), roughness, metallic]), slopes


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
    """The tile's means over texels of `step` of its own; unchanged if step <= 1."""
    if step <= 1.0:
        return tile
    width, height = (max(1, round(side / step)) for side in tile.shape[:0:-1])
    way = cv2.INTER_AREA
    planes = [cv2.resize(plane, (width, height), interpolation=way) for plane in tile[:-1]]
    return np.stack([*planes, resized_height(tile[-1], (width, height))])


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
