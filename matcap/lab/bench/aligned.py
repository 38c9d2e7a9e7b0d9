"""Maps of the photographed piece against its true ones, texel by texel.

Where quality.py compares styles, so that nothing wins by pixel alignment, here truth is at hand:
each map against its own, and relit pictures pixel by pixel, by distance from the flash's foot.
What one photograph cannot tell, the gain between flash and albedo, cancels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.files.srgb import srgb_decode_tensor
from matcap.flash.coarse import CoarseFit, fit_coarse
from matcap.flash.geometry import FlashSetup, camera_in_plane, plane_points
from matcap.lab.bench.baselines import photo_as_albedo
from matcap.lab.bench.piece import photographed_piece
from matcap.lab.bench.relit import BenchScene, bench_scene, relight_all
from matcap.lab.simulate.examples import EXAMPLES
from matcap.lab.simulate.photograph import PhoneCamera, as_photo
from matcap.lab.simulate.specimen import named_specimen, photograph

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


@dataclass(frozen=True)
class AlignedRow:
    """What was found of one material by one method.

    Attributes:
        material: its name.
        method: that found the maps.
        rings: errors by ring.
    """

    material: str
    method: str
    rings: dict[str, AlignedErrors]


def aligned_errors(
    maps: MapSet, setup: FlashSetup, truth: MapSet, true_setup: FlashSetup, scene: BenchScene
) -> dict[str, AlignedErrors]:
    """Errors by ring.

    Args:
        maps: found, of the whole plane rectangle.
        setup: their camera and flash, as found.
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


def aligned_markdown(rows: Sequence[AlignedRow]) -> str:
    """A table of rows."""
    names = [field.name for field in fields(AlignedErrors)]
    lines = [
        "| material | method | ring | " + " | ".join(names) + " |",
        "|---|---|---|" + "---:|" * len(names),
    ]
    for row in rows:
        for ring, errors in row.rings.items():
            numbers = " | ".join(f"{value:.3g}" for value in astuple(errors))
            lines.append(f"| {row.material} | {row.method} | {ring} | {numbers} |")
    return "\n".join(lines) + "\n"


def _difference(pictures: Tensor, truth: MapSet, setup: FlashSetup, scene: BenchScene) -> Tensor:
    """(H, W) mean absolute difference of log radiance over lights."""
    true = relight_all(truth, setup.intensity, scene)

    def log(coded: Tensor) -> Tensor:
        return (srgb_decode_tensor(coded) + _DARKEST).log()

    return (log(pictures) - log(true)).abs().mean((0, 1))


def from_foot(maps: MapSet, setup: FlashSetup) -> Tensor:
    """(H, W) distance of texels from the point below the flash."""
    width, height = maps.size
    points = plane_points(0, 0, width, height, (width, height), dtype=torch.float32)
    foot = camera_in_plane(setup)[1].float()[:2, None, None]
    return (points[:2] - foot).square().sum(0).sqrt()


def _correlation(found: Tensor, true: Tensor) -> float:
    found, true = found - found.mean(), true - true.mean()
    scale = float(found.norm() * true.norm())
    return float((found * true).sum()) / scale if scale > 0.0 else 0.0


def _mean(values: Tensor) -> float:
    return float(values.mean()) if values.numel() else 0.0


def run_aligned(
    out: Path,
    materials: Iterable[str],
    detail: int = 1024,
    tell: Callable[[str], None] = lambda _line: None,
) -> list[AlignedRow]:
    """Photograph materials, find their maps, and compare them with the truth.

    Beside two baselines: the photograph as albedo with flat relief, and the coarse fit alone.

    Args:
        out: folder for the photographs (DNG).
        materials: names in EXAMPLES.
        detail: texels across.
        tell: called with a line for each row.

    Raises:
        UsageError: no such material.
    """
    rows = []
    camera = PhoneCamera()
    for name in materials:
        if name not in EXAMPLES:
            raise UsageError(
                "there is none of this name",
                where=name,
                remedy=f"choose from {', '.join(EXAMPLES)}",
            )
        example = EXAMPLES[name]
        path, shot = photograph(named_specimen(name), camera, out)
        photo = as_photo(shot, example.seed, path.name)
        truth = _shrunk(example.truth(camera), detail)
        piece = photographed_piece(path, detail)
        albedo = photo_as_albedo(photo, shot.setup, detail)
        coarse = fit_coarse(photo)
        scene = bench_scene(shot.setup)
        for method, maps, setup in (
            ("exemplar", piece.whole, piece.setup),
            ("photo-as-albedo", albedo.whole, albedo.setup),
            ("coarse fit", _uniform(coarse, truth), coarse.setup),
        ):
            found = aligned_errors(maps, setup, truth, shot.setup, scene)
            rows.append(AlignedRow(name, method, found))
            tell(f"{name} {method}: relit {found['all'].relit:.3f}")
    return rows


def _shrunk(maps: MapSet, detail: int) -> MapSet:
    """Means over texels of `detail` across."""
    width, height = maps.size
    size = (detail * height // width, detail)
    mean = torch.nn.functional.interpolate(maps.stacked()[None].float(), size, mode="area")[0]
    return MapSet.from_stacked(mean, 2.0 / detail)


def _uniform(coarse: CoarseFit, like: MapSet) -> MapSet:
    """The coarse fit's uniform material, as maps of the size of others."""
    one = torch.ones_like(like.height)
    diffuse = torch.tensor(coarse.diffuse)[:, None, None] * one
    return MapSet(
        diffuse, coarse.specular * one, coarse.roughness * one, 0.0 * one, like.texel_size
    )
