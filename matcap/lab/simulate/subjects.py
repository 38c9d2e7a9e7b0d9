"""What is photographed to judge captures by: simulated materials and map sets of others."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path

from matcap.errors import UsageError
from matcap.flash.geometry import FlashSetup
from matcap.lab.simulate.examples import EXAMPLES
from matcap.lab.simulate.map_sets import map_set_folders, read_map_set
from matcap.lab.simulate.materials.kinds import RandomKind, kind_of, kinds_known
from matcap.lab.simulate.photograph import Realise
from matcap.lab.simulate.specimen import Specimen, named_specimen

# Of kinds of material, one each; no training has seen these numbers but by chance.
NUMBER = 5001
USUAL = (*EXAMPLES, "weave", "asphalt", "hammered")

_PHOTOGRAPHED = 11  # seed of the piece that is photographed, where no example says one
_SETUP = FlashSetup(offset=(0.10, 0.05, 0.0), tilt=(0.02, -0.02))


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
