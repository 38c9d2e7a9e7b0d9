"""Materials that are photographed to judge captures by: all their pieces, and how."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from matcap.flash.geometry import FlashSetup
from matcap.lab.simulate.examples import EXAMPLES, realisation
from matcap.lab.simulate.photograph import PhoneCamera, Realise, Shot, take
from matcap.lab.simulate.write_dng import Sensor, write_dng
from matcap.lab.simulate.write_jpeg import write_jpeg


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
