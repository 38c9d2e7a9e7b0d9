"""Refinement by re-rendering: what the network left unexplained goes to the maps it is sure of least.

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
_LEVEL_NOISE = 0.15  # of log radiance: texture, beside which levels are found
_LEVEL_TEXELS = 100.0  # that count as independent: what the model lacks is smooth
_THIN = 3  # every third texel tells levels
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
    numbers are off once they are there. Robust least squares over all valid texels.

    Args:
        outputs: (OUTPUTS, H, W).
        linear, valid, uniform, points: as for refine.
    """
    light = Light(uniform, points[:, ::_THIN, ::_THIN])
    observed = linear[:, ::_THIN, ::_THIN].clamp_min(_DARKEST).log()
    valid = valid[::_THIN, ::_THIN]
    outputs = outputs.clone()
    deviation = torch.tensor(_LEVELS)
    moved = torch.zeros(5)
    for _ in range(_LEVEL_STEPS):
        found, shares, shows = _linearised(outputs, uniform, light, thin=_THIN)
        residual = observed - found
        residual = torch.where(valid, residual, residual.clamp_min(0.0))
        normal, gradient = torch.zeros(5, 5), torch.zeros(5)
        for channel in range(3):
            column = torch.zeros(5, residual[0].numel())
            column[channel] = shares[channel].flatten()
            column[3:] = shows[:2].flatten(1)
            r = residual[channel].flatten()
            weight = _HUBER / r.abs().clamp_min(_HUBER)
            normal += (column * weight) @ column.T
            gradient += column @ (weight * r)
        scale = _LEVEL_TEXELS / residual.numel() / _LEVEL_NOISE**2
        prior = deviation.square().reciprocal()
        step = torch.linalg.solve(
            normal * scale + torch.diag(prior), gradient * scale - prior * moved
        ).clamp(-_MOST, _MOST)
        moved += step
        outputs[:5] += step[:, None, None]
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
    shares = shows = None
    for _ in range(steps):
        # What shows hardly changes from step to step.
        found, *rest = _linearised(outputs, uniform, light, derivatives=shows is None)
        shares, shows = (shares, shows) if shows is not None else rest
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
    outputs: Tensor, uniform: Uniform, light: Light, *, derivatives: bool = True, thin: int = 1
) -> tuple[Tensor, Tensor, Tensor]:
    """Log radiance (3, H, W), the diffuse share of it, and what log F0, logit roughness and slopes
    change of its grey, (4, H, W); of every `thin`th texel.
    """
    maps = read_outputs(outputs, uniform, 1.0)
    normal = maps.normal[:, ::thin, ::thin]
    maps = maps.map(lambda m: m[:, ::thin, ::thin])
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
    side = max(residual.shape[-2:])
    small = (side // 8, max(1, residual.shape[-2] * (side // 8) // residual.shape[-1]))
    seen = cv2.resize(weight, small, interpolation=cv2.INTER_AREA)
    deviation = small[0] / _SLOW
    under = cv2.GaussianBlur(seen, (0, 0), deviation)
    planes = []
    for plane in residual.clamp(-1.0, 1.0).numpy():
        thin = cv2.resize(plane * weight, small, interpolation=cv2.INTER_AREA)
        smooth = cv2.GaussianBlur(thin, (0, 0), deviation) / under
        planes.append(cv2.resize(smooth, residual.shape[-1:-3:-1], interpolation=cv2.INTER_LINEAR))
    return torch.from_numpy(np.stack(planes))
