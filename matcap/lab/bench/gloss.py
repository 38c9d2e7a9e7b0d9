"""`matcap bench gloss`: estimates of roughness and F0 of plain materials, over exposures.

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
from matcap.lab.experiment.results import Value
from matcap.lab.experiment.runner import Configuration, Experiment
from matcap.lab.simulate.photograph import PhoneCamera, Shot, as_photo, take

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
        down, across = np.gradient(bumps / texel_size)
        steep = float(np.sqrt(np.mean(down**2 + across**2)))
        bumps = np.asarray(bumps * (self.slope / steep), np.float32)
        colour = torch.tensor(self.albedo)[:, None, None].expand(3, height, width)
        return MapSet(
            colour.clone(),
            one * self.specular,
            one * self.roughness,
            torch.from_numpy(bumps)[None],
            texel_size,
        )


@dataclass(frozen=True)
class Gloss:
    """Mean estimates of one photograph, and its share of clipped pixels."""

    roughness: float
    specular: float
    clipped: float


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
) -> Experiment[tuple[PlainMaterial, Shot], Gloss]:
    """Photograph materials at exposure offsets (EV) and estimate their parameters.

    With `exemplar` the maps of a capture are measured, else the coarse fit alone.
    """
    phone = camera or PhoneCamera()

    def prepare(material: PlainMaterial) -> tuple[PlainMaterial, Shot]:
        return material, take(material.realise, phone, SETUP)

    return Experiment(
        "gloss",
        {material.name: partial(prepare, material) for material in chosen},
        {f"{ev:+d} EV": Configuration(partial(_capture_gloss, ev, exemplar)) for ev in evs},
        (gloss,),
        settings=(exemplar, phone),
    )


def gloss(subject: tuple[PlainMaterial, Shot], fitted: Gloss) -> Mapping[str, Value]:
    """The estimates, and whether roughness is near the true one."""
    off = fitted.roughness - subject[0].roughness
    return {
        "roughness": fitted.roughness,
        "off": off,
        "near": float(abs(off) <= WITHIN),
        "F0": fitted.specular,
        "clipped": fitted.clipped,
    }


def _capture_gloss(
    ev: int, exemplar: bool, subject: tuple[PlainMaterial, Shot], _seed: int
) -> Gloss:
    shot = subject[1]
    gain = 2.0**ev
    setup = shot.setup.with_intensity((gain * shot.setup.intensity[0],) * 3)
    brighter = replace(shot, linear=gain * shot.linear, setup=setup)
    photo = as_photo(brighter, 1, "plain")
    clipped = float((brighter.linear.max(-1) >= 1.0).mean())
    if not exemplar:
        fit = fit_coarse(photo)
        return Gloss(fit.roughness, fit.specular, clipped)
    result = capture_photo(photo, CaptureSettings(preset="instant", detail=512))
    assert result.estimate is not None
    maps = result.estimate.exemplar
    return Gloss(float(maps.roughness.mean()), float(maps.specular.mean()), clipped)
