"""The second teacher: losses against true maps of simulated materials, lit from the side.

A flash near the lens gives relief so little contrast that a decoder which cannot localise it does
best without any. A side light shows it; a second loss compares log slope variance by octave, which
penalises missing relief most.
"""

from __future__ import annotations

import math

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.flash.light import FlashLight
from matcap.lab.train.trainer import mixed
from matcap.statistics.compare import Weights, describe, distance
from matcap.statistics.encoding import Encoding
from matcap.statistics.filterbank import FilterBank

_LOWEST, _HIGHEST = math.radians(30.0), math.radians(70.0)  # of the light, from the normal
_OCTAVES = 5  # in which relief is compared, the finest one texel's
_UNSEEN = 0.02  # root-mean-square slope below which a surface is flat to the eye


def side_light(rng: np.random.Generator) -> Tensor:
    """(3,) random direction of a far light, 30 to 70 degrees from the normal."""
    azimuth, angle = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(_LOWEST, _HIGHEST)
    across, up = math.sin(angle) * math.cos(azimuth), math.sin(angle) * math.sin(azimuth)
    return torch.tensor((across, up, math.cos(angle)))


def relit_distance(
    estimate: MapSet,
    truth: MapSet,
    light: Tensor,
    encoding: Encoding,
    bank: FilterBank,
    device: str,
) -> Tensor:
    """(B,) style distance of maps (B, C, H, W) from true ones, seen from above under a far light.

    Each is exposed to the same median: the scale between albedo and flash, ambiguous in one
    photograph, must not count.
    """
    with torch.no_grad(), mixed(device):
        wanted = describe(_exposed(truth, light, encoding), encoding, bank)
    with mixed(device):
        seen = describe(_exposed(estimate, light, encoding), encoding, bank)
    return distance(seen, wanted, Weights())


def relief_distance(estimate: MapSet, truth: MapSet) -> Tensor:
    """(B,) mean over octaves of the absolute difference of log slope variance."""
    differences = [
        ((ours + _UNSEEN**2) / (theirs + _UNSEEN**2)).log().abs()
        for ours, theirs in zip(_octaves(estimate), _octaves(truth), strict=True)
    ]
    return torch.stack(differences).mean(0)


def comb(maps: MapSet) -> Tensor:
    """(B,) penalty on texel-to-texel oscillation of height, 0 to 1.

    Normals are central differences, to which heights alternating from texel to texel are invisible.
    Above 0 if most of the slopes' variance is finer than four texels, 1 for pure alternation.
    """
    between, shown = _between(maps.height / maps.texel_size), _shown(maps)
    return torch.relu(between - 2.0 * shown) / (between + _UNSEEN**2)


def _octaves(maps: MapSet) -> list[Tensor]:
    """(B,) mean squared slopes: as normals show them, between texels, and octave by octave."""
    height = maps.height / maps.texel_size
    octaves = [_shown(maps)]
    for octave in range(_OCTAVES):
        octaves.append(_between(height) / 4.0**octave)
        height = F.avg_pool2d(height, 2)
    return octaves


def _shown(maps: MapSet) -> Tensor:
    normal = maps.normal
    return (normal[..., :2, :, :] / normal[..., 2:, :, :]).square().sum(-3).mean((-2, -1))


def _between(height: Tensor) -> Tensor:
    across, down = height.diff(dim=-1), height.diff(dim=-2)
    return across.square().mean((-3, -2, -1)) + down.square().mean((-3, -2, -1))


def _exposed(maps: MapSet, light: Tensor, encoding: Encoding) -> Tensor:
    """(B, 3, H, W) radiance under a far light, scaled to the encoding's median."""
    incidence = FlashLight.far(light.to(maps.diffuse)).onto(maps.normal, exact=True)
    view = incidence.radiance(maps.diffuse, maps.specular, maps.roughness)
    return view * (encoding.median / view.detach().mean(1).median().clamp_min(1e-6))
