"""Coarse fits and F0 against the truth: `matcap-lab bench highlight`, `gloss` and `metals`.

Real photographs: the highlight is measured alike in photograph and re-rendering
(flash/highlight.py). Simulated ones: errors against the known offset and tilt.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.pipeline import capture_photo
from matcap.capture.run import read_photograph
from matcap.capture.settings import CaptureSettings
from matcap.capture.verdict.judge import visible
from matcap.errors import MatcapError
from matcap.files.pixels import write_picture
from matcap.flash.coarse.fit import CoarseFit, fit_coarse
from matcap.flash.geometry import FlashSetup, plane_points, unproject
from matcap.flash.highlight import CELLS, find_highlight, light_of
from matcap.flash.light import FlashLight, uniform_radiance
from matcap.photo.exif import phone_fov
from matcap.photo.load import load_photo
from matcap.photo.photo import Photo
from matcap_lab.bench.floors import exemplar_maps
from matcap_lab.experiment.results import Value
from matcap_lab.experiment.runner import Configuration, Experiment
from matcap_lab.simulate.kinds import random_kind
from matcap_lab.simulate.named import random_material
from matcap_lab.simulate.photograph import PhoneCamera, Shot, as_photo, take
from matcap_lab.simulate.procedural import rms_slope
from matcap_lab.simulate.specimen import Specimen, photograph

HIGHLIGHT = (
    "Of real photographs: apart: distance of the highlight's centre in photograph and re-rendering "
    "(plane units); width and contrast: the re-rendering's over the photograph's; kept: 1 if these "
    "are within 0.03, 20 % and 20 %. Of simulated ones: errors of the flash's offset (plane units) "
    "and tilt (degrees); visible: 1 if the highlight is clearly visible."
)
# Tolerances of a reproduced highlight: centre in plane units, relative width and contrast.
CENTRE, WIDTH, CONTRAST = 0.03, 0.2, 0.2
# Simulated photographs: degrees across, plane units of offset, degrees of tilt.
_FOV, _OFFSET, _TILT = (40.0, 90.0), (0.02, 0.2), 15.0
_CAMERA = (512, 384)


Seen = tuple[Photo, FlashSetup | None]  # and its true setup where it was simulated


def highlight_experiment(
    photographs: Sequence[Path], count: int, seed: int, out: Path, *, has_fov: bool = True
) -> Experiment[Seen, CoarseFit]:
    """The coarse fit of real photographs that have a highlight, and of `count` simulated ones.

    Pictures of photograph and re-rendering side by side go to `out`. Without `has_fov` simulated
    files do not state their field of view.
    """

    def real(path: Path) -> Seen:
        photo = load_photo(path, noise=False)
        if not visible(find_highlight(light_of(photo.pixels))):
            raise MatcapError("it shows no clear highlight")
        return photo, None

    def pair(seen: Seen, fit: CoarseFit) -> Mapping[str, Value]:
        photo, truth = seen
        if truth is None:
            again = rerendered(fit, photo).astype(np.float32)
            small = cv2.resize(photo.pixels, again.shape[1::-1], interpolation=cv2.INTER_AREA)
            both = np.concatenate([np.minimum(small, 1.0), again], axis=1)
            write_picture(both, out / f"{Path(photo.name).stem}.png")
        return {}

    return Experiment(
        "highlight",
        {path.name: partial(real, path) for path in photographs}
        | simulated(count, seed, has_fov=has_fov),
        {"coarse fit": Configuration(lambda seen, _seed: fit_coarse(seen[0]))},
        (kept, placed, pair),
        settings=(has_fov, [(str(path), path.stat().st_mtime_ns) for path in photographs]),
    )


def kept(seen: Seen, fit: CoarseFit) -> Mapping[str, Value]:
    """Parameters of the highlight in a real photograph and in its re-rendering."""
    photo, truth = seen
    names = ("apart", "width", "contrast", "kept")
    if truth is not None:
        return dict.fromkeys(names, math.nan)
    highlight = find_highlight(light_of(photo.pixels))
    again = find_highlight(rerendered(fit, photo).mean(axis=2))
    assert highlight is not None
    if again is None:
        return dict(zip(names, (math.inf, 0.0, 0.0, 0.0), strict=True))
    distance = math.dist(highlight.centre, again.centre)
    width, contrast = again.width / highlight.width, again.contrast / highlight.contrast
    near = distance <= CENTRE and abs(width - 1.0) <= WIDTH and abs(contrast - 1.0) <= CONTRAST
    return dict(zip(names, (distance, width, contrast, float(near)), strict=True))


def placed(seen: Seen, fit: CoarseFit) -> Mapping[str, Value]:
    """Errors of flash offset and tilt on a simulated photograph."""
    photo, truth = seen
    if truth is None:
        return dict.fromkeys(("offset", "tilt", "visible"), math.nan)
    return {
        "offset": math.dist(fit.setup.offset[:2], truth.offset[:2]),
        "tilt": math.degrees(math.dist(fit.setup.tilt, truth.tilt)),
        "visible": float(visible(find_highlight(light_of(photo.pixels)))),
    }


def rerendered(fit: CoarseFit, photo: Photo) -> NDArray[np.float64]:
    """(h, CELLS, 3) the fit re-rendered by the photograph's camera, clipped at its clip level."""
    rows, columns = photo.pixels.shape[:2]
    height = max(8, round(CELLS * rows / columns))
    image = plane_points(0, 0, CELLS, height, (CELLS, height), dtype=torch.float64)[:2]
    light = FlashLight.of(fit.setup, unproject(image, fit.setup))
    picture = uniform_radiance(fit, light)[0].permute(1, 2, 0).numpy()
    return np.minimum(fit.tone.developed(picture), 1.0)


def simulated(count: int, seed: int, *, has_fov: bool = True) -> dict[str, Callable[[], Seen]]:
    """`count` RAW photographs by name, of random field of view, flash offset and tilt."""
    rng = np.random.default_rng(seed)
    width, height = _CAMERA
    subjects: dict[str, Callable[[], Seen]] = {}
    for number in range(count):
        material = random_kind(rng) if number % 3 else random_material(rng)
        half = math.tan(math.radians(rng.uniform(*_FOV)) / 2.0)
        aside, towards = rng.uniform(*_OFFSET), rng.uniform(0.0, 2.0 * math.pi)
        lean, about = math.radians(rng.uniform(0.0, _TILT)), rng.uniform(0.0, 2.0 * math.pi)
        setup = FlashSetup(
            offset=(aside * math.cos(towards), aside * math.sin(towards), 0.0),
            tilt=(lean * math.cos(about), lean * math.sin(about)),
            vignetting=0.02,
        )
        focal_length = round(18.0 / half)
        camera = PhoneCamera(width, height, focal_length, supersampling=1, blur=0.5)
        name = f"{getattr(material, 'kind', 'pattern')} {seed}/{number}"
        specimen = Specimen(name, material.realise, number, setup)
        subjects[name] = partial(_taken, specimen, camera, has_fov)
    return subjects


def _taken(specimen: Specimen, camera: PhoneCamera, has_fov: bool) -> Seen:
    shot = specimen.take(camera)
    photo = as_photo(shot, specimen.seed, f"{specimen.seed}")
    if not has_fov:
        photo = replace(photo, fov=phone_fov(*photo.original_size), fov_source="assumed")
    return photo, shot.setup


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
