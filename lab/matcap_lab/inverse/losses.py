"""Losses of the inverse network.

Errors of the maps; of renderings under new lights [deschaintre2018], which weight errors by their
visibility; of local band energies of slope and albedo, and of statistics of relit pictures, because
L1 alone shrinks uncertain values to their mean; and a likelihood of the predicted errors. A step's
pictures are evaluated at once, as tensors alone, so that all between the network and the statistics
can be compiled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.cook_torrance import dot
from matcap.brdf.normals import normals_from_height
from matcap.brdf.parameters import Reflectance, SurfaceParameters
from matcap.capture.exemplar.network.network import ExpectedErrors, NetworkAnswer
from matcap.capture.exemplar.tint import seen_colour, specular_tint
from matcap.flash.light import FlashLight
from matcap.statistics.filterbank import FilterBank, FilterBankConfig, pyramid
from matcap.statistics.gram import gram
from matcap_lab.inverse.samples import Sample
from matcap_lab.measures.lights import spherical

_LEVELS = 5  # of the pyramid on which slopes are compared
_CELLS = 48  # texels a side of the cells whose energies are compared
_FLAT = 0.02  # root-mean-square slope, below which energies are not distinguished
_PLAIN = 0.02  # likewise of log albedo
BLACK = 0.02  # albedo: darker ones differ little to the eye
DARKEST = 0.01  # radiance, of a white plane's
LEAST_ERROR = 0.01  # added to errors before their logarithm, which the network predicts
_MOST_F0 = 0.99
_THIN = 2  # stride in texels of pictures under the near light, whose highlight lies anywhere
# Filters for relit pictures, other than those of captures and of their evaluation.
_BANK = FilterBank(FilterBankConfig(sizes=(5,), filters=20, levels=4, seed=91))
_WHITE = 0.35  # mean radiance that pictures are scaled to for their statistics

Parts = dict[str, Tensor]
Compare = Callable[..., tuple[Parts, Tensor, Tensor]]  # `compared`, or that compiled


# Weights of the loss's parts.
WEIGHTS: Mapping[str, float] = MappingProxyType(
    {
        "albedo": 1.0, "specular": 0.3, "roughness": 0.5, "slope": 0.5, "energy": 0.5,
        "render": 1.0, "style": 1.0, "doubt": 0.1, "metal": 0.2,
    }
)  # fmt: skip


@dataclass(frozen=True)
class WantedOutputs:
    """Targets of a step's pictures, stacked."""

    truth: Tensor
    """(B, OUTPUTS, H, W) the network's target."""
    metal: Tensor
    """(B, 1, H, W) true share that is metal."""
    hue: Tensor
    """(B, 3, H, W) true F0 over the mean of its channels."""
    seen: Tensor
    """(B, 3, H, W) the photograph's colour, the specular tint of texels predicted as metal."""
    base: Tensor
    """(B, OUTPUTS, 1, 1) the coarse fit, to which outputs are relative."""
    points: Tensor
    """(3, H, W) plane points, common to all."""
    camera: Tensor
    """(B, 3, 1, 1) positions of the cameras."""
    near: Tensor
    far: Tensor
    """(B, 3, 1, 1) positions of a light with its mirror point in view, and a far one."""


def wanted(samples: Sequence[Sample], rng: np.random.Generator) -> WantedOutputs:
    """Targets of samples of one size, and randomly drawn lights."""
    points = samples[0].points
    lights = [_lights(s, rng) for s in samples]
    places = [(0.0, 0.0, s.uniform.setup.distance) for s in samples]

    def column(vectors: Sequence[Sequence[float]]) -> Tensor:
        return torch.tensor(vectors).to(points)[..., None, None]

    return WantedOutputs(
        torch.stack([s.residuals.stacked() for s in samples]),
        torch.stack([s.metal for s in samples]),
        torch.stack([s.truth.specular / s.truth.specular.mean(0) for s in samples]),
        torch.stack([seen_colour(s.linear, s.valid[None]) for s in samples]),
        torch.stack([s.uniform.parameters().stacked() for s in samples]).to(points),
        points,
        column(places),
        column([near for near, _ in lights]),
        column([far for _, far in lights]),
    )


def loss_parts(
    outputs: Tensor,
    wanted: WantedOutputs,
    *,
    style: bool = True,
    compare: Compare | None = None,
) -> Parts:
    """Parts of the loss of a step's pictures, scalars: means over them.

    Args:
        outputs: (B, ANSWERS, H, W) of the network.
        wanted: the truth.
        style: whether statistics of relit pictures are compared, which takes as long as the rest.
        compare: `compared`, or its compiled form.
    """
    w = wanted
    parts, estimated, true = (compare or compared)(
        outputs, w.truth, (w.metal, w.hue, w.seen), w.base, w.points, w.camera, w.near, w.far
    )
    if style:
        parts = {**parts, "style": _style(estimated, true)}
    return parts


def total(parts: Parts, **others: float) -> Tensor:
    """Sum of the parts, weighted by WEIGHTS or, where they are named, by other weights."""
    weights = {**WEIGHTS, **others}
    return torch.stack([weights[name] * part for name, part in parts.items()]).sum()


def compared(
    outputs: Tensor,
    truth: Tensor,
    metals: tuple[Tensor, Tensor, Tensor],
    base: Tensor,
    points: Tensor,
    camera: Tensor,
    near: Tensor,
    far: Tensor,
) -> tuple[Parts, Tensor, Tensor]:
    """All parts but the style, and (B, 3, H, W) estimated and true pictures under the far light.

    Args:
        outputs: of the network; the others as in WantedOutputs, with metals = (metal, hue, seen).
    """
    answer = NetworkAnswer.from_stacked(outputs)
    estimated, true = answer.residuals, SurfaceParameters.from_stacked(truth)
    uniform = SurfaceParameters.from_stacked(base)
    metal, hue, seen = metals
    maps_estimated = _tinted(
        (uniform + estimated).reflectance(), specular_tint(answer.metal.sigmoid(), seen)
    )
    maps_true = _tinted((uniform + true).reflectance(), hue)
    # Metal's diffuse albedo is too dark for errors of its logarithm to be visible.
    albedo_estimated, albedo_true = (
        m.diffuse.add(BLACK).log() for m in (maps_estimated, maps_true)
    )
    albedo_error = (albedo_estimated - albedo_true).abs()
    specular_error = (estimated.specular - true.specular).abs()
    roughness_error = (estimated.roughness - true.roughness).abs()
    slopes_estimated, slopes_true = _slopes(estimated.height), _slopes(true.height)
    strength = slopes_true[0].square().mean((1, 2, 3)).sqrt() + _FLAT
    slope_errors = [
        (a - b).abs().mean((1, 2, 3)) for a, b in zip(slopes_estimated, slopes_true, strict=True)
    ]
    inner = (..., slice(1, -1), slice(1, -1))
    errors = ExpectedErrors(
        albedo_error.mean(1, keepdim=True)[inner],
        specular_error[inner],
        roughness_error[inner],
        (slopes_estimated[0] - slopes_true[0]).abs().mean(1, keepdim=True),
    ).stacked()
    doubt = (answer.errors.stacked()[inner] - (errors.detach() + LEAST_ERROR).log()).abs().mean()
    normal_estimated, normal_true = (normals_from_height(s.height, 1.0) for s in (estimated, true))
    thin = (..., slice(None, None, _THIN), slice(None, None, _THIN))
    at_near = FlashLight.between(points[thin], camera, near, _power(near))
    at_far = FlashLight.between(points, camera, far, _power(far))
    near_estimated, near_true = (
        at_near.onto(normal[thin]).radiance(*(m[thin] for m in maps))
        for maps, normal in ((maps_estimated, normal_estimated), (maps_true, normal_true))
    )
    far_estimated = at_far.onto(normal_estimated).radiance(*maps_estimated)
    far_true = at_far.onto(normal_true).radiance(*maps_true)
    gain = _WHITE / far_true.mean((1, 2, 3), keepdim=True)
    parts = {
        "albedo": albedo_error.mean(),
        "specular": specular_error.mean(),
        "roughness": roughness_error.mean(),
        "slope": (torch.stack(slope_errors).sum(0) / strength).mean(),
        "energy": _energies(slopes_estimated, slopes_true, albedo_estimated, albedo_true),
        "render": 0.5
        * (_log_error(near_estimated, near_true) + _log_error(far_estimated, far_true)),
        "doubt": doubt,
        "metal": F.binary_cross_entropy_with_logits(answer.metal, metal),
    }
    return parts, far_estimated * gain, far_true * gain


def _tinted(reflectance: Reflectance, hue: Tensor) -> Reflectance:
    """Reflectance with F0 multiplied by the metals' specular tint."""
    return reflectance._replace(specular=(reflectance.specular * hue).clamp_max(_MOST_F0))


def _lights(sample: Sample, rng: np.random.Generator) -> tuple[Sequence[float], Sequence[float]]:
    """Positions of a light whose mirror point lies in the picture, and of a far one."""
    height, width = sample.points.shape[-2:]
    x = float(sample.points[0, 0, int(rng.integers(width))])
    y = float(sample.points[1, int(rng.integers(height)), 0])
    up = rng.uniform(0.6, 2.5)
    there = 1.0 + up / sample.uniform.setup.distance
    polar, around = math.radians(rng.uniform(15.0, 68.0)), rng.uniform(0.0, 2.0 * math.pi)
    distance = rng.uniform(1.3, 3.0)
    return (x * there, y * there, up), spherical(distance, polar, around)


def _slopes(height: Tensor) -> list[Tensor]:
    """(B, 2, h, w) slopes of heights (B, 1, H, W) in texels, level by level of a pyramid."""
    levels = []
    for level in range(_LEVELS):
        if level:
            height = F.avg_pool2d(height, 2)
        step = 2.0 * 2**level
        across = (height[..., 1:-1, 2:] - height[..., 1:-1, :-2]) / step
        down = (height[..., 2:, 1:-1] - height[..., :-2, 1:-1]) / step
        levels.append(torch.cat([across, -down], 1))
    return levels


def _energies(
    estimated: list[Tensor], true: list[Tensor], albedo_estimated: Tensor, albedo_true: Tensor
) -> Tensor:
    """Mean absolute difference of local log band energies of slopes and albedo."""
    differences = []
    for level, (a, b) in enumerate(zip(estimated, true, strict=True)):
        cell = max(4, _CELLS >> level)
        e = (_FLAT / 2**level) ** 2
        differences.append(_strength(a, cell, e) - _strength(b, cell, e))
    bands_estimated, bands_true = _bands(albedo_estimated), _bands(albedo_true)
    for level, (a, b) in enumerate(zip(bands_estimated, bands_true, strict=True)):
        cell = max(4, _CELLS >> level)
        differences.append(0.5 * (_strength(a, cell, _PLAIN**2) - _strength(b, cell, _PLAIN**2)))
    return torch.stack([d.abs().mean() for d in differences]).mean()


def _strength(band: Tensor, cell: int, least: float) -> Tensor:
    """Log root mean square of a band (B, C, h, w) over square cells of `cell` texels."""
    squared = band.square().mean(1, keepdim=True)
    size = min(cell, *squared.shape[-2:])
    return 0.5 * (F.avg_pool2d(squared, size, stride=max(1, size // 2)) + least).log()


def _bands(picture: Tensor) -> list[Tensor]:
    """Differences between levels of a pyramid of pictures (B, C, H, W)."""
    bands = []
    for _ in range(_LEVELS - 1):
        coarse = F.avg_pool2d(picture, 2)
        back = F.interpolate(coarse, scale_factor=2.0, mode="bilinear", align_corners=False)
        bands.append(picture[..., : back.shape[-2], : back.shape[-1]] - back)
        picture = coarse
    return bands


def _log_error(estimated: Tensor, true: Tensor) -> Tensor:
    return ((estimated + DARKEST).log() - (true + DARKEST).log()).abs().mean()


def _style(estimated: Tensor, true: Tensor) -> Tensor:
    """Relative difference of Gram matrices of random filters, of pictures (B, 3, H, W)."""

    def described(picture: Tensor) -> list[Tensor]:
        toned = (picture.clamp(0.0, 1.5) + 1e-3).pow(1.0 / 2.2)
        toned = toned.contiguous(memory_format=torch.channels_last)
        return [gram(_BANK.features(level)) for level in pyramid(toned, _BANK.levels)]

    with torch.no_grad():
        sought = described(true)
    differences = []
    for a, b in zip(described(estimated), sought, strict=True):
        most = a.detach().abs().mean((1, 2)) + b.abs().mean((1, 2)) + 1e-6
        differences.append(((a - b).abs().mean((1, 2)) / most * 2.0).mean())
    return torch.stack(differences).mean()


def _power(light: Tensor) -> Tensor:
    """(B, 1, 1, 1) radiant intensity of lights (B, 3, 1, 1) that makes a white plane's middle 1."""
    return math.pi * dot(light, light) ** 1.5 / light[:, 2:]
