"""`matcap-lab bench metals`: F0 of metals by channel, its hue, and F0 of dielectric parts.

The true maps separate metal from dielectric texels. Errors are
absolute: no scale is fitted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.pipeline import capture_photo, read_photograph
from matcap.capture.settings import CaptureSettings
from matcap_lab.bench.methods import exemplar_maps
from matcap_lab.experiment.results import Value
from matcap_lab.experiment.runner import Configuration, Experiment
from matcap_lab.simulate.photograph import PhoneCamera, Shot
from matcap_lab.simulate.specimen import Specimen, photograph

ABOUT = (
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
    fixes the scale of F0 (capture/exemplar/exposure_prior.py).
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
