"""The example photographs: which material, seed and setup each one shows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from matcap.brdf.maps import MapSet
from matcap.flash.geometry import FlashSetup
from matcap.lab.simulate.materials import realise
from matcap.lab.simulate.photograph import PhoneCamera, Realise, Shot, take, true_maps
from matcap.lab.simulate.write_dng import Sensor


@dataclass(frozen=True)
class ExamplePhotograph:
    """One example photograph.

    Attributes:
        material: a name in MATERIALS.
        seed: of the realisation; the sensor's noise has the same.
        offset: of the flash from the camera, plane units.
        tilt: (tilt_x, tilt_y) in degrees.
        shading: light that the lens loses in the corners; its DNG has GainMaps to undo it.
    """

    material: str
    seed: int
    offset: tuple[float, float, float]
    tilt: tuple[float, float]
    shading: float = 0.0

    @property
    def setup(self) -> FlashSetup:
        """Geometry; the camera adds field of view and intensity."""
        x, y = self.tilt
        return FlashSetup(offset=self.offset, tilt=(math.radians(x), math.radians(y)))

    @property
    def sensor(self) -> Sensor:
        """What its DNG says of the sensor."""
        return Sensor(shading=self.shading)

    @property
    def realise(self) -> Realise:
        """The piece of material that was photographed."""
        return realisation(self.material, self.seed)

    def take(self, camera: PhoneCamera) -> Shot:
        """Photograph it."""
        return take(self.realise, camera, self.setup)

    def truth(self, camera: PhoneCamera) -> MapSet:
        """True maps of the plane rectangle x in [-1, 1], one texel a pixel."""
        return true_maps(self.realise, camera, self.setup)


def realisation(material: str, seed: int) -> Realise:
    """One piece of a named material, of any size and detail."""

    def piece(width: int, height: int, texel_size: float) -> MapSet:
        return realise(material, width, height, seed, texel_size)

    return piece


EXAMPLES: Mapping[str, ExamplePhotograph] = MappingProxyType(
    {
        "leather": ExamplePhotograph("leather", 11, (0.12, 0.05, 0.0), (1.5, -2.0)),
        "cloth": ExamplePhotograph("cloth", 12, (-0.10, 0.06, 0.0), (-1.0, 1.2)),
        "granite": ExamplePhotograph("granite", 13, (0.11, -0.04, 0.0), (2.2, 1.0), shading=0.45),
        "rust": ExamplePhotograph("rust", 14, (0.08, 0.09, 0.0), (-2.0, -1.5)),
        "plaster": ExamplePhotograph("plaster", 15, (0.13, 0.02, 0.0), (1.0, 2.6)),
        "tile": ExamplePhotograph("tile", 16, (-0.07, 0.08, 0.0), (1.8, -1.0)),
    }
)
