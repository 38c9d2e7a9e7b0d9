"""Refinement by re-rendering: what is unexplained goes to the maps that are in doubt most.

First the means of albedo and gloss, then every texel: Gauss-Newton steps in which a residual of
log radiance is shared among albedo, F0 and roughness by how much each shows there and how much it
is in doubt (a Wiener filter whose prior is the network's answer and its expected errors). Relief
is left as it is: what of it lies in the wrong place would be cancelled instead of moved
(docs/notes/exemplar.md). A clipped channel is a lower bound, and the others
tell what they tell. What varies slowly over the whole
picture is what coarse fit and tone curve left undone, not the material, and stays out of the maps.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import Angles, dot, normalize, single_lobe
from matcap.brdf.maps import MapSet
from matcap.brdf.normals import normals_from_slopes
from matcap.capture.piece.network.inputs import read_outputs
from matcap.capture.piece.smooth import smoothed
from matcap.flash.geometry import camera_in_plane
from matcap.flash.render import vignette
from matcap.flash.uniform import Uniform

_STEPS = 3  # of refinement; what is left falls little further
_STEP = 0.03  # of log F0 and logit roughness, for differences of log radiance
_SLOPE = 0.03  # likewise, of slopes
_LEAST_ERROR, _MOST_ERROR = 0.02, 1.0  # expected errors believed in
_DARKEST = 1e-5  # linear radiance
_SLOW = 12.0  # the picture's long side over the deviation of what counts as slow
_MOST = 0.5  # of log radiance a step explains
_GLARE = 0.5  # of log radiance: what a highlight's fit leaves where all light is mirrored
_CHROMA = 0.3  # deviation of albedo's colour as a share of its lightness's
_LEVEL_STEPS = 4
# Deviations of what is off on the whole: log albedo, log F0, logit roughness.
_LEVELS = (0.5, 0.5, 0.5, 0.3, 0.4)
_LEVEL_NOISE = 0.1  # of log radiance: what a cell's mean is off by for other reasons
_LEVEL_CELLS = 100.0  # that count as independent: what the model lacks is smooth
_CELL = 16  # texels
_SEEN = 0.95  # share of a cell that must be valid, or it is a lower bound
_STATIONARY = 8.0  # the long side over the deviation of what a stationary sample is even over
_THINNED = 3  # texels a side of which one is looked at, where things are smooth
_HUBER = 0.2  # of log radiance


@dataclass(frozen=True)
class Refined:
    """Refined outputs and what re-rendering leaves.

    Attributes:
        outputs: (OUTPUTS, H, W) as read_outputs reads them.
        residual: (3, H, W) log photograph over re-rendering, slow part included.
        slow: (3, H, W) its slow part, which the maps do not explain.
    """

    outputs: Tensor
    residual: Tensor
    slow: Tensor


class PieceLight:
    """The photograph's own light at every texel, worked out once."""

    def __init__(self, uniform: Uniform, points: Tensor) -> None:
        """Work it out.

        Args:
            uniform: the coarse fit.
            points: (3, H, W) plane points.
        """
        self.uniform = uniform
        setup = uniform.setup
        camera, light = (v.to(points)[:, None, None] for v in camera_in_plane(setup))
        away = light - points
        squared = dot(away, away)
        self._to_light, self._to_view = normalize(away), normalize(camera - points)
        power = torch.tensor(setup.intensity).to(points)[:, None, None]
        self._power = power * vignette(points, setup) / squared

    def cut(self, rows: slice, columns: slice) -> PieceLight:
        """The light at some of the texels."""
        part = copy.copy(self)
        for name in ("_to_light", "_to_view", "_power"):
            setattr(part, name, getattr(self, name)[:, rows, columns])
        return part

    def maps(self, outputs: Tensor, texel_size: float = 1.0) -> MapSet:
        """Maps of the network's outputs."""
        return read_outputs(outputs, self.uniform, texel_size)

    def angles(self, normal: Tensor) -> Angles:
        """Where light and view come from on a relief of some normals (3, H, W)."""
        return Angles.of(normal, self._to_light, self._to_view)

    def logs(self, maps: MapSet, angles: Angles) -> tuple[Tensor, Tensor]:
        """(3, H, W) log radiance of maps, and the diffuse share of the radiance."""
        power = self._power * angles.n_dot_l
        matte = maps.diffuse / math.pi * power
        lobe = single_lobe(maps.specular, maps.roughness, angles)
        whole = (matte + lobe * power).clamp_min(_DARKEST)
        return whole.log(), matte / whole

    def shows_relief(self, maps: MapSet) -> Tensor:
        """(2, H, W) what dh/dx and dh/dy change of grey log radiance, were all maps flat."""
        one = torch.ones_like(maps.roughness)

        def tilted(x: float, y: float) -> Tensor:
            angles = self.angles(normals_from_slopes(x * one, y * one))
            return self.logs(maps, angles)[0].mean(0)

        across = tilted(_SLOPE, 0.0) - tilted(-_SLOPE, 0.0)
        up = tilted(0.0, _SLOPE) - tilted(0.0, -_SLOPE)
        return torch.stack([across, up]) / (2.0 * _SLOPE)

    def shows(self, maps: MapSet, angles: Angles, log: Tensor) -> Tensor:
        """(2, H, W) what log F0 and logit roughness change of the log radiance that maps have."""
        grey = log.mean(0, keepdim=True)
        brighter = replace(maps, specular=maps.specular * math.exp(_STEP))
        logit = maps.roughness.clamp(1e-3, 0.999).logit()
        duller = replace(maps, roughness=torch.sigmoid(logit + _STEP))
        moved = [self.logs(m, angles)[0].mean(0, keepdim=True) for m in (brighter, duller)]
        return (torch.cat(moved) - grey) / _STEP


@torch.no_grad()
def level(outputs: Tensor, linear: Tensor, valid: Tensor, light: PieceLight) -> Tensor:
    """Outputs whose means of albedo, F0 and roughness re-render to the photograph's brightness.

    The coarse fit has no relief: bumps widen highlights and dim what lies between, so that its
    numbers are off once they are there. Robust least squares over cells, each by its mean
    radiance: relief that is right in strength and wrong in place still spreads light rightly.

    Args:
        outputs: (OUTPUTS, H, W).
        linear, valid, light: as for refine.
    """
    cell = min(_CELL, *linear.shape[-2:])
    seen = F.avg_pool2d(valid.expand_as(linear).float(), cell) > _SEEN
    observed = F.avg_pool2d(linear, cell).clamp_min(_DARKEST).log()
    outputs = outputs.clone()
    prior = torch.tensor(_LEVELS).square().reciprocal()
    moved = torch.zeros(5)
    scale = _LEVEL_CELLS / observed.numel() / _LEVEL_NOISE**2
    angles = light.angles(light.maps(outputs).normal)
    for _ in range(_LEVEL_STEPS):
        maps = light.maps(outputs)
        log, shares = light.logs(maps, angles)
        shows = light.shows(maps, angles, log)
        radiance = log.exp().clamp_max(1.0)
        mean = F.avg_pool2d(radiance, cell)
        residual = observed - mean.clamp_min(_DARKEST).log()
        residual = torch.where(seen, residual, residual.clamp_min(0.0))
        # What shows of a cell is what shows of its light.
        grey = radiance.mean(0, keepdim=True)
        by_albedo = F.avg_pool2d(shares * radiance, cell) / mean
        by_gloss = F.avg_pool2d(shows * grey, cell) / F.avg_pool2d(grey, cell)
        normal, gradient = torch.zeros(5, 5), torch.zeros(5)
        for channel in range(3):
            column = torch.zeros(5, residual[0].numel())
            column[channel] = by_albedo[channel].flatten()
            column[3:] = by_gloss.flatten(1)
            r = residual[channel].flatten()
            weight = _HUBER / r.abs().clamp_min(_HUBER)
            normal += (column * weight) @ column.T
            gradient += column @ (weight * r)
        step = torch.linalg.solve(
            normal * scale + torch.diag(prior), gradient * scale - prior * moved
        ).clamp(-_MOST, _MOST)
        moved += step
        outputs[:5] += step[:, None, None]
    return outputs


def flatten(outputs: Tensor, confidence: Tensor, glare: NDArray[np.float32]) -> Tensor:
    """Outputs whose albedo and gloss are the same everywhere on average.

    A stationary sample's means do not drift, and nothing of it follows the highlight. Gloss is told
    near the highlight and albedo beside it: every map's mean is the one where it is trusted.

    Args:
        outputs: (OUTPUTS, H, W).
        confidence: (>= 3, H, W) of albedo, F0 and roughness, in [0, 1].
        glare: (H, W) share of the radiance that is mirrored.
    """
    outputs = outputs.clone()
    shape = np.stack([np.ones_like(glare), glare, np.square(glare)])
    for channel in range(5):
        weight = confidence[max(0, channel - 2)].square() + 1e-3
        mean = (outputs[channel] * weight).sum() / weight.sum()
        outputs[channel] -= torch.from_numpy(_following(outputs[channel].numpy(), shape))
        slow = smoothed(outputs[channel].numpy(), max(outputs.shape[-2:]) / _STATIONARY)
        outputs[channel] += mean - torch.from_numpy(slow)
    return outputs


def _following(plane: NDArray[np.float32], shape: NDArray[np.float32]) -> NDArray[np.float32]:
    """What of a plane (H, W) goes with some smooth shapes (N, H, W): least squares.

    Sums are NumPy's own, on one thread: the same bits whatever the machine is doing.
    """
    thin = shape[:, ::_THINNED, ::_THINNED].astype(np.float64)
    products = np.einsum("nhw,mhw->nm", thin, thin, optimize=False)
    told = np.einsum("nhw,hw->n", thin, plane[::_THINNED, ::_THINNED], optimize=False)
    weights = np.linalg.lstsq(products, told, rcond=1e-9)[0].astype(np.float32)
    return np.asarray(np.einsum("n,nhw->hw", weights, shape, optimize=False), np.float32)


@torch.no_grad()
def refine(
    outputs: Tensor,
    errors: Tensor,
    linear: Tensor,
    valid: Tensor,
    light: PieceLight,
    *,
    noise: float = 0.02,
) -> Refined:
    """Move albedo and gloss until they re-render to the photograph.

    Args:
        outputs: (OUTPUTS, H, W) of the network.
        errors: (ERRORS, H, W) log of what it expects to be off by.
        linear: (3, H, W) the photograph on the plane's grid.
        valid: (H, W) or (3, H, W) bool, seen and not clipped, by channel where that is known.
        light: the photograph's own.
        noise: deviation of log radiance that is not explained.
    """
    observed = linear.clamp_min(_DARKEST).log()
    outputs = outputs.clone()
    valid = valid.expand_as(linear)
    doubt = errors.exp().clamp(_LEAST_ERROR, _MOST_ERROR).square()
    albedo, gloss = doubt[:1], doubt[1:3]
    colour = albedo * _CHROMA**2
    maps = light.maps(outputs)
    angles = light.angles(maps.normal)
    found, shares = light.logs(maps, angles)
    shows = light.shows(maps, angles, found)  # hardly changes from step to step
    for step in range(_STEPS):
        if step:
            found, shares = light.logs(light.maps(outputs), angles)
        residual = _unexplained(observed, found, valid)
        residual = (residual - _slow(residual, valid)).clamp(-_MOST, _MOST)
        tells = valid | (residual > 0.0)
        share = shares.mean(0, keepdim=True)
        grey = (residual * tells).sum(0, keepdim=True) / tells.sum(0, keepdim=True).clamp_min(1)
        unknown = noise**2 + (_GLARE * (1.0 - share)).square()
        total = share.square() * albedo + (shows.square() * gloss).sum(0, keepdim=True) + unknown
        common = grey / total
        # A bound that holds says nothing of the colour.
        apart = torch.where(tells, residual - grey, 0.0)
        own = apart * shares * colour / (shares.square() * colour + unknown)
        outputs[:3] += share * albedo * common + own
        outputs[3:5] += shows * gloss * common
    return remaining(outputs, linear, valid, light)


def remaining(outputs: Tensor, linear: Tensor, valid: Tensor, light: PieceLight) -> Refined:
    """Outputs (OUTPUTS, H, W) and what their re-rendering leaves; arguments as for refine."""
    maps = light.maps(outputs)
    found, _ = light.logs(maps, light.angles(maps.normal))
    residual = _unexplained(linear.clamp_min(_DARKEST).log(), found, valid)
    return Refined(outputs, residual, _slow(residual, valid))


def _unexplained(observed: Tensor, found: Tensor, valid: Tensor) -> Tensor:
    """(3, H, W) residual of log radiance; of a clipped texel only what is too dark."""
    residual = observed - found
    return torch.where(valid, residual, residual.clamp_min(0.0))


def _slow(residual: Tensor, valid: Tensor) -> Tensor:
    """What of a residual (3, H, W) varies slowly, by valid texels."""
    deviation = max(valid.shape) / _SLOW
    weights = valid.expand_as(residual).numpy().astype(np.float32) + np.float32(1e-4)
    planes = [
        smoothed(plane * weight, deviation) / smoothed(weight, deviation)
        for plane, weight in zip(residual.clamp(-1, 1).numpy(), weights, strict=True)
    ]
    return torch.from_numpy(np.stack(planes))
