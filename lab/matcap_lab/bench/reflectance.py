"""Coarse fits and F0 against the truth: `matcap-lab bench gloss` and `metals`."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.pipeline import capture_photo
from matcap.capture.run import read_photograph
from matcap.capture.settings import CaptureSettings
from matcap.flash.coarse.fit import fit_coarse
from matcap.flash.geometry import FlashSetup
from matcap_lab.bench.floors import exemplar_maps
from matcap_lab.experiment.results import Value
from matcap_lab.experiment.runner import Configuration, Experiment
from matcap_lab.simulate.photograph import PhoneCamera, Shot, as_photo, take
from matcap_lab.simulate.procedural import rms_slope
from matcap_lab.simulate.specimen import Specimen, photograph

# `matcap-lab bench gloss`: estimates of roughness and F0 of plain materials, over exposures.
#
# Uniform albedo, F0 and roughness, flat or with bumps that break the highlight up, photographed at
# the automatic exposure and some EV above it, so that more of the highlight is clipped.

GLOSS = (
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
    camera: PhoneCamera = PhoneCamera(),  # noqa: B008
) -> Experiment[PlainShot, Mapping[str, Value]]:
    """Photograph materials at exposure offsets (EV) and fit them coarsely."""

    def prepare(material: PlainMaterial) -> PlainShot:
        return material, take(material.realise, camera, SETUP)

    return Experiment(
        "gloss",
        {material.name: partial(prepare, material) for material in chosen},
        {f"{ev:+d} EV": Configuration(partial(_estimates, ev)) for ev in evs},
        settings=camera,
    )


def _estimates(ev: int, subject: PlainShot, _seed: int) -> Mapping[str, Value]:
    """Mean estimates of one photograph, `ev` EV above the automatic exposure."""
    (material, shot), gain = subject, 2.0**ev
    setup = shot.setup.with_intensity((gain * shot.setup.intensity[0],) * 3)
    brighter = replace(shot, linear=gain * shot.linear, setup=setup)
    fit = fit_coarse(as_photo(brighter, 1, "plain"))
    off = fit.roughness - material.roughness
    return {
        "roughness": fit.roughness,
        "off": off,
        "near": float(abs(off) <= WITHIN),
        "F0": fit.specular,
        "clipped": float((brighter.linear.max(-1) >= 1.0).mean()),
    }


# `matcap-lab bench metals`: F0 of metals by channel, its hue, and F0 of dielectric parts.
#
# The true maps separate metal from dielectric texels. Errors are
# absolute: no scale is fitted.

METALS = (
    "Red, green, blue: estimated over true F0 where the truth is metal. Hue: deviation of each "
    "channel's ratio from their mean, %; empty if the estimated F0 is achromatic. Beside: mean F0 "
    "of dielectric texels, estimated and true."
)
# Mean F0 above which a texel is metal, below which it is dielectric; borders are left out.
METAL, NONE = 0.2, 0.08
_LEAST_SHARE = 0.01
_CHANNELS = ("red", "green", "blue")


@dataclass(frozen=True)
class PhotographedMetal:
    """A photograph, and the truth."""

    path: Path
    shot: Shot
    truth: MapSet


def metals_experiment(
    subjects: Sequence[Specimen],
    out: Path,
    settings: CaptureSettings,
    camera: PhoneCamera,
    *,
    known: bool = False,
) -> Experiment[PhotographedMetal, MapSet]:
    """Photograph into `out` and capture each.

    With `known` the flash's intensity is given, as by a calibration card; else the exposure prior
    fixes the scale of F0 (capture/exemplar/mean_parameters.py).
    """

    def prepare(subject: Specimen) -> PhotographedMetal:
        return PhotographedMetal(*photograph(subject, camera, out), subject.truth(camera))

    def run(metal: PhotographedMetal, _seed: int) -> MapSet:
        photo = read_photograph(metal.path, settings)
        if known:
            photo = replace(photo, flash_intensity=metal.shot.setup.intensity[1])
        return exemplar_maps(capture_photo(photo, settings)).maps

    return Experiment(
        "metals",
        {subject.name: partial(prepare, subject) for subject in subjects},
        {"flash known" if known else "exemplar": Configuration(run)},
        (lambda metal, estimate: f0_errors(estimate, metal.truth),),
        settings=(settings, camera),
    )


def f0_errors(estimate: MapSet, truth: MapSet) -> Mapping[str, Value]:
    """Errors of estimated maps against true maps of the same rectangle, on any grid."""
    size = estimate.specular.shape[-2:]
    true = F.interpolate(truth.specular[None].float(), size, mode="area")[0].expand(3, -1, -1)
    f0 = estimate.specular.float().expand(3, -1, -1)
    grey = true.mean(0)
    metal, rest = grey > METAL, grey < NONE
    of_metal, true_of_metal = _mean(f0, metal), _mean(true, metal)
    brightness = of_metal / true_of_metal
    hue = 100.0 * (brightness / (of_metal.sum() / true_of_metal.sum()) - 1.0)
    coloured = len(estimate.specular) > 1
    has_rest = float(rest.float().mean()) > _LEAST_SHARE
    return {
        **dict(zip(_CHANNELS, brightness.tolist(), strict=True)),
        **{
            f"{name} hue": float(off) if coloured else math.nan
            for name, off in zip(_CHANNELS, hue, strict=True)
        },
        "dielectric": float(f0[:, rest].mean()) if has_rest else math.nan,
        "true dielectric": float(true[:, rest].mean()) if has_rest else math.nan,
    }


def _mean(planes: Tensor, where: Tensor) -> Tensor:
    """(3,) mean of each channel over `where`; over all texels if it is empty."""
    return planes[:, where].mean(1) if bool(where.any()) else planes.mean((1, 2))
