"""What is photographed to judge captures by: simulated materials and map sets of others."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from matcap.errors import UsageError
from matcap.flash.geometry import FlashSetup
from matcap.lab.simulate.examples import EXAMPLES, realisation
from matcap.lab.simulate.map_sets import map_set_folders, read_map_set
from matcap.lab.simulate.materials.kinds import KINDS, RandomKind, kind_of
from matcap.lab.simulate.photograph import Realise
from matcap.lab.simulate.write_dng import Sensor

# Of kinds of material, one each; no training has seen these numbers but by chance.
NUMBER = 5001
USUAL = (*EXAMPLES, "weave", "asphalt", "hammered")

_PHOTOGRAPHED = 11  # seed of the piece that is photographed, where no example says one
_SETUP = FlashSetup(offset=(0.10, 0.05, 0.0), tilt=(0.02, -0.02))


@dataclass(frozen=True)
class Subject:
    """A material whose truth is known.

    Attributes:
        name: of it.
        piece: one realisation of it, by seed.
        seed: of the one that is photographed.
        setup: where the flash was, and the tilt.
        sensor: what its DNG says of the camera's.
    """

    name: str
    piece: Callable[[int], Realise]
    seed: int = _PHOTOGRAPHED
    setup: FlashSetup = _SETUP
    sensor: Sensor = field(default_factory=Sensor)


def subjects(names: Iterable[str], sets: Path | None = None) -> list[Subject]:
    """Subjects by name, and of every map set in a folder.

    Args:
        names: of EXAMPLES, of KINDS ("weave", or "weave:7" for another one of the kind), or of a
            map set in the folder; where there is none and a folder, all sets in it.
        sets: folder of map sets (matcap/lab/simulate/map_sets.py).

    Raises:
        UsageError: no such material.
        MatcapError: a map set that cannot be read.
    """
    folders = {folder.name: folder for folder in map_set_folders(sets)} if sets else {}
    chosen = list(names) or list(folders) or USUAL
    return [_subject(name, folders) for name in chosen]


def _subject(name: str, folders: dict[str, Path]) -> Subject:
    if name in EXAMPLES:
        example = EXAMPLES[name]
        return Subject(
            name, partial(realisation, name), example.seed, example.setup, example.sensor
        )
    if name in folders:
        return Subject(name, read_map_set(folders[name]).piece)
    kind, _, number = name.partition(":")
    if kind in KINDS and (number.isdecimal() or not number):
        return Subject(name, partial(_of_kind, kind_of(kind, int(number or NUMBER))))
    known = ", ".join([*EXAMPLES, *KINDS, *folders])
    raise UsageError("there is no such material", where=name, remedy=f"choose from {known}")


def _of_kind(material: RandomKind, seed: int) -> Realise:
    return lambda width, height, texel_size: material.realise(width, height, seed, texel_size)
