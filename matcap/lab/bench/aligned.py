"""`matcap bench aligned`: errors of captured maps against the true ones, texel by texel.

Unlike style distances, which ignore alignment, these are errors of each map and of relit pictures
against the photographed sample's own, by distance from the point below the flash. The scale between
flash and albedo, ambiguous in one photograph, is removed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.files.srgb import srgb_decode_tensor
from matcap.flash.coarse.fit import CoarseFit, fit_coarse
from matcap.flash.geometry import FlashSetup, camera_in_plane, plane_points
from matcap.lab.bench.methods import CapturedMaps, capture_exemplar, exemplar_maps, photo_as_albedo
from matcap.lab.experiment.runner import Configuration, Experiment, choose
from matcap.lab.measures.lights import BenchScene, bench_scene, relight_all
from matcap.lab.measures.maps import shrunk_to
from matcap.lab.simulate.photograph import PhoneCamera, as_photo
from matcap.lab.simulate.specimen import EXAMPLES, Specimen, photograph

ABOUT = (
    "Albedo and specular: mean absolute differences of logarithms; roughness: of values; normal: "
    "degrees, where the true relief is steeper than 3; height: correlation; relit: mean absolute "
    "difference of log radiance under other lights. By distance from the point below the flash."
)
METHODS = ("exemplar", "photo-as-albedo", "coarse fit")
# Distances from the flash's foot in plane units that divide the picture.
RINGS = (("foot", 0.0, 0.35), ("middle", 0.35, 0.75), ("rim", 0.75, math.inf), ("all", 0.0, 9.0))
_STEEP = math.radians(3.0)  # relief is judged where it is steeper
_BLACK = 0.02  # albedo: darker ones differ little to the eye
_DARKEST = 0.01  # radiance, where the clip level is 1


@dataclass(frozen=True)
class AlignedErrors:
    """Mean errors of a ring.

    Attributes:
        albedo, specular: absolute difference of logarithms.
        roughness: absolute difference.
        normal: degrees, where the true relief is steeper than 3 degrees.
        height: correlation with the true height.
        relit: absolute difference of log radiance over the bench's lights.
    """

    albedo: float
    specular: float
    roughness: float
    normal: float
    height: float
    relit: float


def aligned_errors(
    maps: MapSet, setup: FlashSetup, truth: MapSet, true_setup: FlashSetup, scene: BenchScene
) -> dict[str, AlignedErrors]:
    """Errors by ring.

    Args:
        maps: estimated, of the whole plane rectangle.
        setup: estimated camera and flash.
        truth: true maps of the same texels.
        true_setup: true camera and flash.
        scene: lights to relight under.
    """
    gain = setup.intensity[1] / true_setup.intensity[1]
    tilted = (maps.normal * truth.normal).sum(0).clamp(-1.0, 1.0).acos().rad2deg()
    relit = _difference(relight_all(maps, setup.intensity, scene), truth, true_setup, scene)
    distance = from_foot(truth, true_setup)
    steep = truth.normal[2] < math.cos(_STEEP)
    albedo = ((maps.diffuse * gain + _BLACK).log() - (truth.diffuse + _BLACK).log()).abs().mean(0)
    specular = ((maps.specular * gain).log() - truth.specular.log()).abs().mean(0)
    roughness = (maps.roughness - truth.roughness).abs()[0]

    def ring(nearest: float, furthest: float) -> AlignedErrors:
        here = (distance >= nearest) & (distance < furthest)
        return AlignedErrors(
            albedo=_mean(albedo[here]),
            specular=_mean(specular[here]),
            roughness=_mean(roughness[here]),
            normal=_mean(tilted[here & steep]),
            height=_correlation(maps.height[0][here], truth.height[0][here]),
            relit=_mean(relit[here]),
        )

    return {name: ring(nearest, furthest) for name, nearest, furthest in RINGS}


def _difference(pictures: Tensor, truth: MapSet, setup: FlashSetup, scene: BenchScene) -> Tensor:
    """(H, W) mean absolute difference of log radiance over lights."""
    true = relight_all(truth, setup.intensity, scene)

    def log(coded: Tensor) -> Tensor:
        return (srgb_decode_tensor(coded) + _DARKEST).log()

    return (log(pictures) - log(true)).abs().mean((0, 1))


def from_foot(maps: MapSet, setup: FlashSetup) -> Tensor:
    """(H, W) distance of texels from the point below the flash, plane units."""
    width, height = maps.size
    points = plane_points(0, 0, width, height, (width, height), dtype=torch.float32)
    foot = camera_in_plane(setup)[1].float()[:2, None, None]
    return (points[:2] - foot).square().sum(0).sqrt()


def _correlation(estimate: Tensor, true: Tensor) -> float:
    estimate, true = estimate - estimate.mean(), true - true.mean()
    scale = float(estimate.norm() * true.norm())
    return float((estimate * true).sum()) / scale if scale > 0.0 else 0.0


def _mean(values: Tensor) -> float:
    return float(values.mean()) if values.numel() else 0.0


@dataclass(frozen=True)
class AlignedSubject:
    """A photograph's true maps, and errors of its estimated maps by method and ring."""

    errors_by_model: Callable[[str], Mapping[str, AlignedErrors]]


def aligned_experiment(
    materials: Sequence[str], out: Path, detail: int = 1024
) -> Experiment[AlignedSubject, AlignedErrors]:
    """Errors by ring of the exemplar, the photograph as albedo, and the coarse fit.

    Args:
        materials: names in EXAMPLES; all by default.
        out: folder for the photographs (DNG).
        detail: texels across.

    Raises:
        UsageError: no such material.
    """

    def prepare(example: Specimen) -> AlignedSubject:
        camera = PhoneCamera()
        path, shot = photograph(example, camera, out)
        photo = as_photo(shot, example.seed, path.name)
        truth, scene = shrunk_to(example.truth(camera), 2.0 / detail), bench_scene(shot.setup)

        @cache
        def errors(method: str) -> Mapping[str, AlignedErrors]:
            if method == "exemplar":
                made = exemplar_maps(capture_exemplar(path, detail))
            elif method == "coarse fit":
                coarse = fit_coarse(photo)
                made = CapturedMaps(_uniform(coarse, truth), coarse.setup)
            else:
                made = photo_as_albedo(photo, shot.setup, detail)
            return aligned_errors(made.maps, made.setup, truth, shot.setup, scene)

        return AlignedSubject(errors)

    def run(method: str, ring: str, aligned: AlignedSubject, _seed: int) -> AlignedErrors:
        return aligned.errors_by_model(method)[ring]

    return Experiment(
        "aligned",
        {name: partial(prepare, one) for name, one in choose(EXAMPLES, materials).items()},
        {
            f"{method}, {ring}": Configuration(partial(run, method, ring), method)
            for method in METHODS
            for ring, _, _ in RINGS
        },
        (lambda _subject, errors: asdict(errors),),
        settings=detail,
    )


def _uniform(coarse: CoarseFit, like: MapSet) -> MapSet:
    """The coarse fit's uniform material, as maps of the size of others."""
    one = torch.ones_like(like.height)
    diffuse = torch.tensor(coarse.diffuse)[:, None, None] * one
    return MapSet(
        diffuse, coarse.specular * one, coarse.roughness * one, 0.0 * one, like.texel_size
    )
