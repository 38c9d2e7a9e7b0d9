"""A material that is photographed to judge captures by: all its pieces, and how."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from matcap.flash.geometry import FlashSetup
from matcap.lab.simulate.photograph import Realise
from matcap.lab.simulate.write_dng import Sensor


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
