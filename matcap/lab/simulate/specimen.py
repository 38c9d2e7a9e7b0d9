"""Specimens: materials with known truth that captures are evaluated on."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from matcap.errors import UsageError
from matcap.flash.geometry import FlashSetup
from matcap.lab.simulate.examples import EXAMPLES, realisation
from matcap.lab.simulate.map_sets import map_set_folders, read_map_set
from matcap.lab.simulate.materials.kinds import RandomKind, kind_of, kinds_known
from matcap.lab.simulate.photograph import PhoneCamera, Realise, Shot, take
from matcap.lab.simulate.write_dng import Sensor, write_dng
from matcap.lab.simulate.write_jpeg import write_jpeg

# Of kinds of material, one each; no training has seen these numbers but by chance.
NUMBER = 5001
USUAL = (*EXAMPLES, "weave", "asphalt", "hammered")

_PHOTOGRAPHED = 11  # seed of the piece that is photographed, where no example says one
_SETUP = FlashSetup(offset=(0.10, 0.05, 0.0), tilt=(0.02, -0.02))


@dataclass(frozen=True)
class Specimen:
    """A material whose truth is known.

    Attributes:
        name: of the material.
        pieces: by seed.
        seed: of the piece that is photographed.
        setup: geometry of the photograph.
        sensor: what its DNG says.
    """

    name: str
    pieces: Callable[[int], Realise]
    seed: int
    setup: FlashSetup
    sensor: Sensor = field(default_factory=Sensor)


def named_specimen(name: str) -> Specimen:
    """The material of an example photograph, a key of EXAMPLES."""
    example = EXAMPLES[name]
    pieces = partial(realisation, name)
    return Specimen(name, pieces, example.seed, example.setup, example.sensor)


def photograph(
    specimen: Specimen, camera: PhoneCamera, out: Path, *, ev: float = 0.0, jpeg: bool = False
) -> tuple[Path, Shot]:
    """Photograph a specimen into a folder.

    Args:
        specimen: the material.
        camera: that takes the photograph.
        out: the folder, made when missing.
        ev: exposure offset in stops, above what the camera would choose.
        jpeg: a JPEG, instead of a DNG.

    Returns:
        The file, and the truth.

    Raises:
        MatcapError: the folder cannot be written.
    """
    shot = take(specimen.pieces(specimen.seed), camera, specimen.setup)
    gain = 2.0**ev
    red, green, blue = (gain * channel for channel in shot.setup.intensity)
    shot = Shot(gain * shot.linear, shot.setup.with_intensity((red, green, blue)), camera)
    path = out / f"{specimen.name.replace(':', '-')}.{'jpg' if jpeg else 'dng'}"
    if jpeg:
        write_jpeg(path, shot, specimen.seed)
    else:
        write_dng(path, shot, specimen.sensor, specimen.seed)
    return path, shot


def subjects(names: Iterable[str], sets: Path | None = None) -> list[Specimen]:
    """Subjects by name, and of every map set in a folder.

    Args:
        names: of EXAMPLES, of a kind ("weave", or "weave:7" for another one of it), or of a map
            set in the folder; where there is none and a folder, all sets in it.
        sets: folder of map sets (matcap/lab/simulate/map_sets.py).

    Raises:
        UsageError: no such material.
        MatcapError: a map set that cannot be read.
    """
    folders = {folder.name: folder for folder in map_set_folders(sets)} if sets else {}
    chosen = list(names) or list(folders) or USUAL
    return [_subject(name, folders) for name in chosen]


def _subject(name: str, folders: dict[str, Path]) -> Specimen:
    if name in EXAMPLES:
        return named_specimen(name)
    if name in folders:
        return Specimen(name, read_map_set(folders[name]).piece, _PHOTOGRAPHED, _SETUP)
    kind, _, number = name.partition(":")
    if kind in kinds_known() and (number.isdecimal() or not number):
        pieces = partial(_of_kind, kind_of(kind, int(number or NUMBER)))
        return Specimen(name, pieces, _PHOTOGRAPHED, _SETUP)
    known = ", ".join([*EXAMPLES, *kinds_known(), *folders])
    raise UsageError("there is no such material", where=name, remedy=f"choose from {known}")


def _of_kind(material: RandomKind, seed: int) -> Realise:
    return lambda width, height, texel_size: material.realise(width, height, seed, texel_size)
