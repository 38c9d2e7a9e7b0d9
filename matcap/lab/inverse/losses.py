"""What the inverse network's answer is judged by.

Beside the maps' own errors: renderings under lights it was not photographed by (Deschaintre et al.
2018), which say how much an error shows; energies of slope and albedo per band and place, because
L1 alone shrinks what is in doubt; statistics of the relit pictures, for the same reason; and the
errors it expects of itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.cook_torrance import Angles, dot, normalize, single_lobe
from matcap.brdf.maps import MapSet
from matcap.capture.piece.network.inputs import read_outputs, true_outputs
from matcap.capture.piece.network.network import OUTPUTS
from matcap.lab.inverse.samples import Sample
from matcap.statistics.filterbank import FilterBank, FilterBankConfig, pyramid
from matcap.statistics.gram import gram

_LEVELS = 5  # of the pyramid on which slopes are compared
_CELLS = 48  # texels a side of the places whose energies are compared
_FLAT = 0.02  # root-mean-square slope, below which strength is not told apart
_PLAIN = 0.02  # likewise of log albedo
_BLACK = 0.02  # albedo: darker ones differ little to the eye
_DARKEST = 0.01  # radiance, of a white plane's
_LIGHTS = 2
# Of relit pictures; other filters than those a capture is tuned by or judged by.
_BANK = FilterBank(FilterBankConfig(sizes=(5,), filters=20, levels=4, seed=91))
_WHITE = 0.35  # radiance of a picture's mean, as its statistics are taken


@dataclass(frozen=True)
class LossWeights:
    """How much each part counts."""

    albedo: float = 1.0
    specular: float = 0.3
    roughness: float = 0.5
    slope: float = 0.5
    energy: float = 0.5
    render: float = 1.0
    style: float = 1.0
    doubt: float = 0.1


def loss_parts(
    outputs: Tensor, sample: Sample, rng: np.random.Generator, lights: int = _LIGHTS
) -> dict[str, Tensor]:
    """Parts of the loss of one picture, scalars.

    Args:
        outputs: (OUTPUTS + ERRORS, H, W) of the network.
        sample: what it was shown, and the truth.
        rng: draws lights.
        lights: rendered under.
    """
    truth = true_outputs(sample.truth, sample.uniform)
    found = outputs[:OUTPUTS]
    maps = read_outputs(found, sample.uniform, sample.truth.texel_size)
    # Of a metal's dark diffuse albedo nothing is seen but that it is dark.
    albedo_found = (maps.diffuse + _BLACK).log()
    albedo_true = (sample.truth.diffuse + _BLACK).log()
    albedo_apart = (albedo_found - albedo_true).abs()
    apart = (found - truth).abs()
    slopes_found, slopes_true = _slopes(found[5:6]), _slopes(truth[5:6])
    strength = slopes_true[0].square().mean().sqrt() + _FLAT
    slope_apart = [(a - b).abs().mean() for a, b in zip(slopes_found, slopes_true, strict=True)]
    fine = (slopes_found[0] - slopes_true[0]).abs().mean(0)
    inner = (slice(1, -1), slice(1, -1))
    errors = torch.stack([albedo_apart.mean(0)[inner], apart[3][inner], apart[4][inner], fine])
    doubt = (outputs[OUTPUTS:, 1:-1, 1:-1] - (errors.detach() + 0.01).log()).abs().mean()
    render, style = _rendered(maps, sample, rng, lights)
    return {
        "albedo": albedo_apart.mean(),
        "specular": apart[3].mean(),
        "roughness": apart[4].mean(),
        "slope": torch.stack(slope_apart).sum() / strength,
        "energy": _energies(slopes_found, slopes_true, albedo_found, albedo_true),
        "render": render,
        "style": style,
        "doubt": doubt,
    }


def total(parts: dict[str, Tensor], weights: LossWeights = LossWeights()) -> Tensor:
    """Weighted sum of the parts."""
    return torch.stack([getattr(weights, name) * part for name, part in parts.items()]).sum()


def _slopes(height: Tensor) -> list[Tensor]:
    """(2, h, w) slopes of heights (1, H, W) in texels, level by level of a pyramid."""
    levels = []
    for level in range(_LEVELS):
        if level:
            height = F.avg_pool2d(height[None], 2)[0]
        step = 2.0 * 2**level
        across = (height[:, 1:-1, 2:] - height[:, 1:-1, :-2]) / step
        down = (height[:, 2:, 1:-1] - height[:, :-2, 1:-1]) / step
        levels.append(torch.cat([across, -down]))
    return levels


def _energies(
    found: list[Tensor], true: list[Tensor], albedo_found: Tensor, albedo_true: Tensor
) -> Tensor:
    """Mean difference of log strength over bands and places."""
    differences = []
    for level, (a, b) in enumerate(zip(found, true, strict=True)):
        cell = max(4, _CELLS >> level)
        e = (_FLAT / 2**level) ** 2
        differences.append(_strength(a, cell, e) - _strength(b, cell, e))
    bands_found, bands_true = _bands(albedo_found), _bands(albedo_true)
    for level, (a, b) in enumerate(zip(bands_found, bands_true, strict=True)):
        cell = max(4, _CELLS >> level)
        differences.append(0.5 * (_strength(a, cell, _PLAIN**2) - _strength(b, cell, _PLAIN**2)))
    return torch.stack([d.abs().mean() for d in differences]).mean()


def _strength(band: Tensor, cell: int, least: float) -> Tensor:
    """Log root-mean-square of a band (C, h, w) in cells."""
    squared = band.square().mean(0, keepdim=True)[None]
    size = min(cell, *squared.shape[-2:])
    return 0.5 * (F.avg_pool2d(squared, size, stride=max(1, size // 2)) + least).log()


def _bands(picture: Tensor) -> list[Tensor]:
    """Differences between levels of a pyramid of a picture (C, H, W)."""
    bands = []
    for _ in range(_LEVELS - 1):
        coarse = F.avg_pool2d(picture[None], 2)
        back = F.interpolate(coarse, scale_factor=2.0, mode="bilinear", align_corners=False)[0]
        bands.append(picture[:, : back.shape[1], : back.shape[2]] - back)
        picture = coarse[0]
    return bands


def _rendered(
    maps: MapSet, sample: Sample, rng: np.random.Generator, lights: int
) -> tuple[Tensor, Tensor]:
    """Mean difference of log radiance, and of style, under lights elsewhere."""
    distance = sample.uniform.setup.distance
    height, width = sample.points.shape[-2:]
    camera = torch.tensor([0.0, 0.0, distance]).to(sample.points)[:, None, None]
    to_view = normalize(camera - sample.points)
    normals_found, normals_true = maps.normal, sample.truth.normal
    differences: list[Tensor] = []
    pairs: list[tuple[Tensor, Tensor]] = []
    for index in range(lights):
        if index == 0:  # a highlight somewhere in the picture
            x = sample.points[0, 0, int(rng.integers(width))]
            y = sample.points[1, int(rng.integers(height)), 0]
            up = rng.uniform(0.6, 2.5)
            there = torch.stack([x, y]) * (1.0 + up / distance)
            light = torch.tensor([float(there[0]), float(there[1]), up])
        else:
            polar, around = math.radians(rng.uniform(15.0, 68.0)), rng.uniform(0.0, 2.0 * math.pi)
            far = rng.uniform(1.3, 3.0)
            light = far * torch.tensor(
                [
                    math.sin(polar) * math.cos(around),
                    math.sin(polar) * math.sin(around),
                    math.cos(polar),
                ]
            )
        found = _lit(maps, normals_found, sample.points, light, to_view)
        with torch.no_grad():
            true = _lit(sample.truth, normals_true, sample.points, light, to_view)
        differences.append(((found + _DARKEST).log() - (true + _DARKEST).log()).abs().mean())
        if index:
            gain = _WHITE / float(true.mean())
            pairs.append(((found * gain), (true * gain)))
    styles = [_style(a, b) for a, b in pairs]
    return torch.stack(differences).mean(), torch.stack(styles).mean()


def _style(found: Tensor, true: Tensor) -> Tensor:
    """Relative difference of Gram matrices of random filters of two pictures (3, H, W)."""

    def described(picture: Tensor) -> list[Tensor]:
        toned = (picture.clamp(0.0, 1.5) + 1e-3).pow(1.0 / 2.2)[None]
        return [gram(_BANK.features(level)) for level in pyramid(toned, _BANK.levels)]

    with torch.no_grad():
        wanted = described(true)
    apart = [
        (a - b).abs().mean() / (a.detach().abs().mean() + b.abs().mean() + 1e-6) * 2.0
        for a, b in zip(described(found), wanted, strict=True)
    ]
    return torch.stack(apart).mean()


def _lit(maps: MapSet, normal: Tensor, points: Tensor, light: Tensor, to_view: Tensor) -> Tensor:
    """Radiance of maps by a light that makes a white plane's middle 1; float32 throughout."""
    away = light.to(points)[:, None, None] - points
    squared = dot(away, away)
    to_light = away * squared.rsqrt()
    angles = Angles.of(normal, to_light, to_view)
    lobe = single_lobe(maps.specular, maps.roughness, angles)
    strength = math.pi * float(light.square().sum()) ** 1.5 / float(light[2])
    return (maps.diffuse / math.pi + lobe) * angles.n_dot_l / squared * strength
