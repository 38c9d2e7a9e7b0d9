"""Distributions of phone photographs: exposure, clipping, tilt, flash and distance.

Fitted to every third of 126 phone photographs of flat samples under their own flash (2026-11-24) at
512 texels. Mean linear radiance: 5th and 95th percentiles 0.07 and 0.21; median 0.133, standard
deviation of the logarithm 0.35. Clipped pixels: none at the median, 0.05 % at the 75th percentile,
1 % at the 95th. Coarse fits: tilts of deviation 2.0 and 1.7 degrees, a flash 0.08 plane units above
the lens. No file states its distance: 20 to 40 cm, as the guide asks for.
"""

from __future__ import annotations

import json
import math
import zlib
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from matcap.brdf.maps import MapSet
from matcap.capture.registration.camera import PosedCamera
from matcap.flash.geometry import FlashSetup
from matcap_lab.simulate.hand_held import Hand, hold, take_several
from matcap_lab.simulate.photograph import PhoneCamera, RealiseAt
from matcap_lab.simulate.specimen import Specimen

_BRIGHTNESS = (0.133, 0.35)  # of the clip level: median, and deviation of the logarithm
_CLIPPED = ((0.0, 0.5, 0.75, 0.95, 1.0), (0.0, 0.0, 5e-4, 0.01, 0.02))  # shares, by quantile
_TILT = 0.032  # radians: deviation about either axis
_FLASH = ((0.01, 0.04), (0.08, 0.045))  # plane units: mean and deviation, across and up
_DISTANCE = math.log(2.0) / 2.0  # 20 to 40 cm, about their geometric mean
_DRAWN = 42  # seed of the draws, together with a material's name


@dataclass(frozen=True)
class PhonePhotographs:
    """A material, scaled for the distance, and how it is photographed.

    The phone has its exposure; `tilt` is the first photograph's, radians.
    """

    specimen: Specimen
    phone: PhoneCamera
    hand: Hand
    tilt: tuple[float, float]

    @staticmethod
    def of(specimen: Specimen, phone: PhoneCamera) -> PhonePhotographs:
        """Draw how a specimen is photographed; the draw depends on its name alone."""
        rng = np.random.default_rng([zlib.crc32(specimen.name.encode()), _DRAWN])
        brightness = _BRIGHTNESS[0] * math.exp(rng.normal(0.0, _BRIGHTNESS[1]))
        clipped = float(np.interp(rng.random(), *_CLIPPED))
        tilt_x, tilt_y = np.clip(rng.normal(0.0, _TILT, 2), -3.0 * _TILT, 3.0 * _TILT).tolist()
        x, y = (rng.normal(*each) for each in _FLASH)
        further = math.exp(rng.uniform(-_DISTANCE, _DISTANCE))
        return PhonePhotographs(
            replace(specimen, material=partial(_from_further, specimen.material, further)),
            replace(phone, brightness=brightness, clipped=clipped),
            Hand(flash=(x, y, 0.0)),
            (tilt_x, tilt_y),
        )

    def take(self, count: int, out: Path) -> tuple[list[Path], FlashSetup]:
        """Paths of `count` DNGs and the first one's true setup; taken anew if any is missing.

        Raises:
            MatcapError: the folder cannot be written.
        """
        subject = self.specimen
        paths = [subject.path(out, number) for number in range(count)]
        sidecar = out / "setup.json"
        if not all(path.exists() for path in (sidecar, *paths)):
            cameras = hold(self.phone, self.hand, count, subject.seed)
            first = FlashSetup(fov=self.phone.fov, tilt=self.tilt)
            cameras[0] = PosedCamera.of(first, self.hand.bent)
            shots = take_several(subject.realise, self.phone, cameras, self.hand, subject.seed)
            for number, shot in enumerate(shots):
                subject.write(shot, out, number)
            sidecar.write_text(json.dumps({"intensity": shots[0].setup.intensity}))
        red, green, blue = json.loads(sidecar.read_text())["intensity"]
        setup = FlashSetup(fov=self.phone.fov, offset=self.hand.flash, tilt=self.tilt)
        return paths, setup.with_intensity((red, green, blue))


def _from_further(
    material: RealiseAt, factor: float, width: int, height: int, seed: int, texel_size: float
) -> MapSet:
    """A realisation seen from `factor` times the distance, so scaled down by `factor`."""
    maps = material(width, height, seed, factor * texel_size)
    return replace(maps, height=maps.height / factor, texel_size=texel_size)
