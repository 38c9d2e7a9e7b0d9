"""`matcap bench camera`: coarse fits of one camera's photographs.

Real photographs give the scatter of the fitted vignetting and how often metal is detected;
simulated ones, of known vignetting, also the errors of albedo, F0 and roughness.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

from matcap.brdf.maps import MapSet
from matcap.capture.tilt import fit_photograph
from matcap.flash.coarse.fit import CoarseFit
from matcap.lab.experiment.results import Value
from matcap.lab.experiment.runner import Configuration, Experiment
from matcap.lab.simulate.photograph import PhoneCamera, as_photo
from matcap.lab.simulate.specimen import Specimen
from matcap.lab.simulate.write_jpeg import PHONE
from matcap.photo.load import load_photo
from matcap.photo.photo import Photo

ABOUT = (
    "lost: fitted falloff in the corners, log radiance; exponent: of the tone curve; metal: 1 if "
    "classified as metal. Errors on simulated photographs: of lost and roughness, and of log F0, "
    "log albedo and their difference, which does not depend on the flash's intensity."
)
_PHONE = PhoneCamera(width=512, height=384)
_WIDTH = 512  # pixels across of real ones


@dataclass(frozen=True)
class CameraSubject:
    """A photograph; of a simulated one also its true maps and vignetting."""

    photo: Photo
    truth: MapSet | None = None
    lost: float = math.nan


def camera_experiment(
    photographs: Sequence[Path],
    specimens: Sequence[Specimen],
    falloff: tuple[float, float],
    *,
    developed: bool = False,
) -> Experiment[CameraSubject, CoarseFit]:
    """Fit photographs.

    `falloff`, the simulated camera's vignetting, has the coefficients of r^2 and r^4. `developed`
    simulates JPEGs with a phone's tone curve, not RAW.
    """

    def simulated(specimen: Specimen) -> CameraSubject:
        lost, more = falloff
        setup = replace(specimen.setup, vignetting=lost, vignetting_quartic=more)
        specimen = replace(specimen, setup=setup)
        photo = as_photo(specimen.take(_PHONE), specimen.seed, specimen.name)
        if developed:
            photo = replace(photo, radiometric=False, pixels=PHONE.developed(photo.pixels))
        return CameraSubject(photo, specimen.truth(_PHONE), sum(falloff))

    def real(path: Path) -> CameraSubject:
        return CameraSubject(load_photo(path, long_side=_WIDTH, noise=False))

    prepared: dict[str, Callable[[], CameraSubject]] = {
        **{path.name: cache(partial(real, path)) for path in photographs},
        **{specimen.name: cache(partial(simulated, specimen)) for specimen in specimens},
    }

    return Experiment(
        "camera",
        prepared,
        {
            "alone": Configuration(lambda subject, _seed: fit_photograph(subject.photo)),
        },
        (fit_errors,),
        settings=(falloff, developed, list(prepared)),
    )


def fit_errors(subject: CameraSubject, fit: CoarseFit) -> Mapping[str, Value]:
    """Parameters of a coarse fit, and their errors against the truth."""
    lost = fit.setup.vignetting + fit.setup.vignetting_quartic
    fitted_values = {
        "lost": lost,
        "exponent": fit.tone.exponent,
        "metal": float(fit.conductor),
        "roughness": fit.roughness,
    }
    names = ("lost off", "roughness off", "F0 off", "albedo off", "F0 over albedo off")
    if subject.truth is None:
        return fitted_values | dict.fromkeys(names, math.nan)
    true = subject.truth
    specular = math.log(fit.specular / float(true.specular.mean()))
    diffuse = math.log(sum(fit.diffuse) / 3.0 / float(true.diffuse.mean()))
    off = (
        lost - subject.lost, fit.roughness - float(true.roughness.mean()), specular, diffuse,
        specular - diffuse,
    )  # fmt: skip
    return fitted_values | dict(zip(names, map(abs, off), strict=True))
