"""Refinement by re-rendering: what is unexplained goes to the maps that are in doubt most.

Gauss-Newton steps in which every texel's residual of log radiance is shared among albedo, F0,
roughness and slope by how much each shows there and how much it is in doubt (a Wiener filter whose
prior is the network's answer and its expected errors). Slopes are made heights again after every
step. Clipped texels are lower bounds. What varies slowly over the whole picture is what coarse fit
and tone curve left undone, not the material, and stays out of the maps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import dot, ggx, normalize, schlick, smith_visibility
from matcap.brdf.normals import normals_from_slopes
from matcap.capture.exemplar.integrate import integrate
from matcap.flash.geometry import camera_in_plane
from matcap.flash.render import vignette
from matcap.model.inverse.inputs import Uniform, read_outputs

_STEP = 0.03  # of slope, log F0 and logit roughness, for differences of log radiance
_LEAST_ERROR, _MOST_ERROR = 0.02, 1.0  # expected errors believed in
_DARKEST = 1e-5  # linear radiance
_SLOW = 12.0  # the picture's long side over the deviation of what counts as slow
_MOST = 0.5  # of log radiance a step explains
_CHROMA = 0.3  # deviation of albedo's colour as a share of its lightness's
_LEVEL_STEPS = 4
# Deviations of what is off on the whole: log albedo, log F0, logit roughness.
_LEVELS = (0.5, 0.5, 0.5, 0.3, 0.4)
_LEVEL_NOISE = 0.1  # of log radiance: what a cell's mean is off by for other reasons
_LEVEL_CELLS = 100.0  # that count as independent: what the model lacks is smooth
_CELL = 16  # texels
_SEEN = 0.95  # share of a cell that must be valid, or it is a lower bound
_STATIONARY = 8.0  # the long side over the deviation of what a stationary sample is even over
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


class Light:
    """The photograph's own light at every texel, worked out once."""

    def __init__(self, uniform: Uniform, points: Tensor) -> None:
        setup = uniform.setup
        camera, light = (v.to(points)[:, None, None] for v in camera_in_plane(setup))
        away = light - points
        squared = dot(away, away)
        self.to_light, self.to_view = normalize(away), normalize(camera - points)
        self.half = normalize(self.to_light + self.to_view)
        self.l_dot_h = dot(self.to_light, self.half)
        power = torch.tensor(setup.intensity).to(points)[:, None, None]
        self.power = power * vignette(points, setup) / squared

    def radiance(
        self, diffuse: Tensor, specular: Tensor, roughness: Tensor, sx: Tensor, sy: Tensor
    ) -> tuple[Tensor, Tensor]:
        """(3, H, W) radiance of maps with slopes, and its diffuse part."""
        normal = normals_from_slopes(sx, sy)
        cross = torch.linalg.cross(normal, self.half, dim=-3)
        n_dot_l = dot(normal, self.to_light).clamp_min(1e-3)
        n_dot_v = dot(normal, self.to_view).clamp_min(1e-3)
        alpha = roughness.clamp_min(0.03).square()
        lobe = (
            ggx(dot(normal, self.half), dot(cross, cross), alpha)
            * smith_visibility(n_dot_l, n_dot_v, alpha)
            * schlick(specular, self.l_dot_h)
        )
        power = self.power * n_dot_l
        matte = diffuse / math.pi * power
        return matte + lobe * power, matte


@torch.no_grad()
def level(
    outputs: Tensor, linear: Tensor, valid: Tensor, uniform: Uniform, points: Tensor
) -> Tensor:
    """Outputs whose means of albedo, F0 and roughness re-render to the photograph's brightness.

    The coarse fit has no relief: bumps widen highlights and dim what lies between, so that its
    numbers are off once they are there. Robust least squares over cells, each by its mean
    radiance: relief that is right in strength and wrong in place still spreads light rightly.

    Args:
        outputs: (OUTPUTS, H, W).
        linear, valid, uniform, points: as for refine.
    """
    light = Light(uniform, points)
    cell = min(_CELL, *linear.shape[-2:])
    share = F.avg_pool2d(valid[None].float(), cell)
    observed = F.avg_pool2d(linear, cell).clamp_min(_DARKEST).log()
    seen = (share > _SEEN).expand_as(observed)
    outputs = outputs.clone()
    prior = torch.tensor(_LEVELS).square().reciprocal()
    moved = torch.zeros(5)
    scale = _LEVEL_CELLS / observed.numel() / _LEVEL_NOISE**2
    for _ in range(_LEVEL_STEPS):
        log, shares, shows = _linearised(outputs, uniform, light)
        radiance = log.exp().clamp_max(1.0)
        mean = F.avg_pool2d(radiance, cell)
        residual = observed - mean.clamp_min(_DARKEST).log()
        residual = torch.where(seen, residual, residual.clamp_min(0.0))
        # What shows of a cell is what shows of its light.
        grey = radiance.mean(0, keepdim=True)
        by_albedo = F.avg_pool2d(shares * radiance, cell) / mean
        by_gloss = F.avg_pool2d(shows[:2] * grey, cell) / F.avg_pool2d(grey, cell)
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


def flatten(outputs: Tensor, confidence: Tensor) -> Tensor:
    """Outputs whose albedo and gloss are the same everywhere on average.

    A stationary sample's means do not drift. Gloss is told near the highlight and albedo beside
    it: every map's mean is the one where it is trusted.

    Args:
        outputs: (OUTPUTS, H, W).
        confidence: (>= 3, H, W) of albedo, F0 and roughness, in [0, 1].
    """
    outputs = outputs.clone()
    for channel in range(5):
        weight = confidence[max(0, channel - 2)].square() + 1e-3
        mean = (outputs[channel] * weight).sum() / weight.sum()
        slow = _smoothed(outputs[channel].numpy(), _STATIONARY)
        outputs[channel] += mean - torch.from_numpy(slow)
    return outputs


@torch.no_grad()
def refine(
    outputs: Tensor,
    errors: Tensor,
    linear: Tensor,
    valid: Tensor,
    uniform: Uniform,
    points: Tensor,
    *,
    steps: int = 3,
    noise: float = 0.02,
    relief: bool = True,
) -> Refined:
    """Move outputs until they re-render to the photograph.

    Args:
        outputs: (OUTPUTS, H, W) of the network.
        errors: (ERRORS, H, W) log of what it expects to be off by.
        linear: (3, H, W) the photograph on the plane's grid.
        valid: (H, W) bool, seen and not clipped.
        uniform: the coarse fit.
        points: (3, H, W) plane points.
        steps: of Gauss-Newton.
        noise: deviation of log radiance that is not explained.
        relief: slopes may move, too.
    """
    light = Light(uniform, points)
    observed = linear.clamp_min(_DARKEST).log()
    outputs = outputs.clone()
    albedo, specular, roughness, slope = (
        errors.exp().clamp(_LEAST_ERROR, _MOST_ERROR).square().split(1)
    )
    slope = slope * float(relief)
    # What shows hardly changes from step to step.
    found, shares, shows = _linearised(outputs, uniform, light)
    for step in range(steps):
        if step:
            found, _, _ = _linearised(outputs, uniform, light, derivatives=False)
        residual = observed - found
        residual = torch.where(valid, residual, residual.clamp_min(0.0))
        residual = (residual - _slow(residual, valid)).clamp(-_MOST, _MOST)
        grey, share = residual.mean(0, keepdim=True), shares.mean(0, keepdim=True)
        by_f0, by_roughness, by_x, by_y = shows.split(1)
        total = (
            share.square() * albedo
            + by_f0.square() * specular
            + by_roughness.square() * roughness
            + (by_x.square() + by_y.square()) * slope
            + noise**2
        )
        common = grey / total
        colour = albedo * _CHROMA**2
        own = (residual - grey) * shares * colour / (shares.square() * colour + noise**2)
        outputs[:3] += share * albedo * common + own
        outputs[3:4] += by_f0 * specular * common
        outputs[4:5] += by_roughness * roughness * common
        if relief:
            outputs[5:6] += integrate(by_x * slope * common, by_y * slope * common)
    found, _, _ = _linearised(outputs, uniform, light, derivatives=False)
    residual = torch.where(valid, observed - found, (observed - found).clamp_min(0.0))
    return Refined(outputs, residual, _slow(residual, valid))


def _linearised(
    outputs: Tensor, uniform: Uniform, light: Light, *, derivatives: bool = True
) -> tuple[Tensor, Tensor, Tensor]:
    """Log radiance (3, H, W), the diffuse share of it, and what log F0, logit roughness and slopes
    change of its grey, (4, H, W).
    """
    maps = read_outputs(outputs, uniform, 1.0)
    normal = maps.normal
    sx, sy = -normal[:1] / normal[2:], -normal[1:2] / normal[2:]
    whole, matte = light.radiance(maps.diffuse, maps.specular, maps.roughness, sx, sy)
    log = whole.clamp_min(_DARKEST).log()
    shares = matte / whole.clamp_min(_DARKEST)
    if not derivatives:
        return log, shares, shares
    grey = log.mean(0, keepdim=True)

    def change(specular: Tensor, roughness: Tensor, x: Tensor, y: Tensor) -> Tensor:
        moved = light.radiance(maps.diffuse, specular, roughness, x, y)[0]
        return (moved.clamp_min(_DARKEST).log().mean(0, keepdim=True) - grey) / _STEP

    duller = torch.sigmoid(maps.roughness.clamp(1e-3, 0.999).logit() + _STEP)
    shows = torch.cat(
        [
            change(maps.specular * math.exp(_STEP), maps.roughness, sx, sy),
            change(maps.specular, duller, sx, sy),
            change(maps.specular, maps.roughness, sx + _STEP, sy),
            change(maps.specular, maps.roughness, sx, sy + _STEP),
        ]
    )
    return log, shares, shows


def _slow(residual: Tensor, valid: Tensor) -> Tensor:
    """What of a residual (3, H, W) varies slowly, by valid texels."""
    weight = valid.numpy().astype(np.float32) + 1e-4
    under = _smoothed(weight, _SLOW)
    planes = [_smoothed(plane * weight, _SLOW) / under for plane in residual.clamp(-1, 1).numpy()]
    return torch.from_numpy(np.stack(planes))


def _smoothed(plane: NDArray[np.float32], parts: float) -> NDArray[np.float32]:
    """A plane (H, W) blurred by its long side over `parts`; on fewer texels, which is as good."""
    size = plane.shape[::-1]
    small = (max(1, size[0] // 8), max(1, size[1] // 8))
    thin = cv2.resize(plane, small, interpolation=cv2.INTER_AREA)
    smooth = cv2.GaussianBlur(thin, (0, 0), max(small) / parts)
    return np.asarray(cv2.resize(smooth, size, interpolation=cv2.INTER_LINEAR), np.float32)
