"""Specimens: materials with known truth that captures are evaluated on."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.flash.geometry import FlashSetup
from matcap_lab.simulate.map_sets import map_set_folders, read_map_set
from matcap_lab.simulate.materials import realise
from matcap_lab.simulate.materials.kinds import kind_of, kinds_known
from matcap_lab.simulate.photograph import PhoneCamera, Realise, RealiseAt, Shot, take, true_maps
from matcap_lab.simulate.write_dng import write_dng
from matcap_lab.simulate.write_jpeg import PHONE, write_jpeg

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
        sets: folder of map sets (matcap_lab/simulate/map_sets.py).

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
