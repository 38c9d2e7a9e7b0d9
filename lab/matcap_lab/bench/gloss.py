"""`matcap-lab bench gloss`: estimates of roughness and F0 of plain materials, over exposures.

Uniform albedo, F0 and roughness, flat or with bumps that break the highlight up, photographed at
the automatic exposure and some EV above it, so that more of the highlight is clipped.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
import torch

from matcap.brdf.maps import MapSet
from matcap.capture.pipeline import capture_photo
from matcap.capture.settings import CaptureSettings
from matcap.flash.coarse.fit import fit_coarse
from matcap.flash.geometry import FlashSetup
from matcap_lab.experiment.results import Value
from matcap_lab.experiment.runner import Configuration, Experiment
from matcap_lab.simulate.photograph import PhoneCamera, Shot, as_photo, take
from matcap_lab.simulate.procedural import rms_slope

ABOUT = (
    "Estimated roughness and F0; off: error of roughness; near: 1 if that is within 0.05; clipped: "
    "share of the photograph. Subjects: slope of bumps, red albedo, F0, roughness."
)
SETUP = FlashSetup(offset=(0.10, 0.05, 0.0), tilt=(0.02, -0.02))
WITHIN = 0.05  # of roughness
_BUMPS = 0.03  # plane units apart


@dataclass(frozen=True)
class PlainMaterial:
    """An even material: linear albedo, F0, perceptual roughness, RMS slope of its bumps."""

    albedo: tuple[float, float, float]
    specular: float
    roughness: float
    slope: float

    @property
    def name(self) -> str:
        """Slope, red albedo, F0 and roughness."""
        return f"{self.slope:g}, {self.albedo[0]:g}, {self.specular:g}, {self.roughness:g}"

    def realise(self, width: int, height: int, texel_size: float) -> MapSet:
        """A piece of it; the same bumps at any detail."""
        one = torch.ones(1, height, width)
        count = round(2.0 / _BUMPS)
        heights = np.random.default_rng(3).standard_normal((count, count)).astype(np.float32)
        side = max(width, height)
        bumps = cv2.resize(heights, (side, side), interpolation=cv2.INTER_CUBIC)[:height, :width]
        bumps = np.asarray(bumps * (self.slope / rms_slope(bumps / texel_size, 1.0)), np.float32)
        colour = torch.tensor(self.albedo)[:, None, None].expand(3, height, width)
        return MapSet(
            colour.clone(),
            one * self.specular,
            one * self.roughness,
            torch.from_numpy(bumps)[None],
            texel_size,
        )


PlainShot = tuple[PlainMaterial, Shot]


def materials(slopes: Sequence[float]) -> Iterator[PlainMaterial]:
    """All combinations of roughness, F0, albedo and slope."""
    for slope, albedo, specular, roughness in itertools.product(
        slopes,
        ((0.3, 0.2, 0.15), (0.02, 0.02, 0.02)),
        (0.04, 0.1),
        (0.05, 0.1, 0.15, 0.2, 0.4, 0.7, 0.95),
    ):
        yield PlainMaterial(albedo, specular, roughness, slope)


def gloss_experiment(
    chosen: Iterator[PlainMaterial],
    evs: Sequence[int],
    *,
    exemplar: bool = False,
    camera: PhoneCamera | None = None,
) -> Experiment[PlainShot, Mapping[str, Value]]:
    """Photograph materials at exposure offsets (EV) and estimate their parameters.

    With `exemplar` the maps of a capture are measured, else the coarse fit alone.
    """
    phone = camera or PhoneCamera()

    def prepare(material: PlainMaterial) -> PlainShot:
        return material, take(material.realise, phone, SETUP)

    return Experiment(
        "gloss",
        {material.name: partial(prepare, material) for material in chosen},
        {f"{ev:+d} EV": Configuration(partial(_estimates, ev, exemplar)) for ev in evs},
        settings=(exemplar, phone),
    )


def _estimates(ev: int, exemplar: bool, subject: PlainShot, _seed: int) -> Mapping[str, Value]:
    """Mean estimates of one photograph, `ev` EV above the automatic exposure."""
    (material, shot), gain = subject, 2.0**ev
    setup = shot.setup.with_intensity((gain * shot.setup.intensity[0],) * 3)
    brighter = replace(shot, linear=gain * shot.linear, setup=setup)
    photo = as_photo(brighter, 1, "plain")
    if exemplar:
        estimate = capture_photo(photo, CaptureSettings("instant", detail=512)).estimate
        assert estimate is not None
        maps = estimate.exemplar
        roughness, specular = float(maps.roughness.mean()), float(maps.specular.mean())
    else:
        fit = fit_coarse(photo)
        roughness, specular = fit.roughness, fit.specular
    off = roughness - material.roughness
    return {
        "roughness": roughness,
        "off": off,
        "near": float(abs(off) <= WITHIN),
        "F0": specular,
        "clipped": float((brighter.linear.max(-1) >= 1.0).mean()),
    }
