"""Inputs of the inverse network.

The photograph enters as the logarithm of its radiance over that of a uniform material in the same
setup (the coarse fit), and the setup as its sensitivities: the derivatives of log radiance by slope
and by roughness at every texel. So one network serves every field of view, flash and tilt. Heights
are in texels, so slopes are rise over run at any resolution.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.capture.exemplar.network.network import NetworkInputs
from matcap.flash.geometry import camera_in_plane
from matcap.flash.light import FlashLight
from matcap.flash.render import Uniform, uniform_radiance

MOST_RESIDUAL = 3.0  # log radiance; residuals are clipped to +-this
_STEP = 0.03  # step of slope and of logit roughness in finite differences of radiance
SUBSAMPLING = 4  # subsampling, texels, of renderings of the uniform material, which are smooth
_DAMPING = 0.1  # regularises the first-order slope estimate where the sensitivity vanishes


def network_inputs(
    linear: Tensor, valid: Tensor, uniform: Uniform, points: Tensor
) -> NetworkInputs:
    """Compute the network's inputs for a picture on the plane's grid.

    Args:
        linear: (3, H, W) scene-linear radiance.
        valid: (H, W) bool, visible and not clipped.
        uniform: the coarse fit.
        points: (3, H, W) plane points of the texels (flash.geometry.plane_points).
    """
    height, width = linear.shape[-2:]
    size = tuple(max(2, -(-side // SUBSAMPLING)) for side in (height, width))
    # A coarse grid from the first to the last texel, whose points are linear in the index.
    thin = _resized(points, size)
    light = FlashLight.of(uniform.setup, thin)
    flat, diffuse = uniform_radiance(uniform, light)
    _, flash = (v.to(points)[:, None, None] for v in camera_in_plane(uniform.setup))
    smooth = {
        "flat": flat.log(),
        "tangent": (flash - thin)[:2] / (flash - thin)[2:],
        "slope": _shown_of_slope(uniform, light),
        "roughness": _shown_of_roughness(uniform, light, flat),
        "gloss": 1.0 - diffuse.mean(0, keepdim=True) / flat.mean(0, keepdim=True),
    }
    channels = [len(plane) for plane in smooth.values()]
    planes = _resized(torch.cat(list(smooth.values())), (height, width)).split(channels)
    everywhere = dict(zip(smooth, planes, strict=True))
    log = (linear.clamp_min(1e-6).log() - everywhere["flat"]).clamp(-MOST_RESIDUAL, MOST_RESIDUAL)
    sensitivity = everywhere["slope"]
    # To first order: the slope along the gradient that this residual of log radiance implies.
    steep = sensitivity.square().sum(0, keepdim=True) + _DAMPING**2
    relief = log.mean(0, keepdim=True) * sensitivity / steep
    constants = torch.tensor(
        [
            float(uniform.parameters().roughness) / 2.0,
            (math.log(uniform.specular) + 3.0) / 2.0,
            (math.log(sum(uniform.diffuse) / 3.0) + 1.5) / 2.0,
        ]
    ).to(points)
    return NetworkInputs(
        log=log,
        valid=valid[None].to(log),
        tangent=everywhere["tangent"],
        slope_sensitivity=sensitivity.clamp(-4.0, 4.0),
        roughness_sensitivity=everywhere["roughness"].clamp(-2.0, 2.0),
        gloss=everywhere["gloss"],
        uniform=constants[:, None, None].expand(3, height, width),
        relief=relief.clamp(-3.0, 3.0) * 0.5,
    )


def _shown_of_slope(uniform: Uniform, light: FlashLight) -> Tensor:
    """(2, h, w) d log L / d slope along x and y, by central differences."""
    # One call for all four, as calls dominate the time of small tensors.
    moves = torch.tensor([[_STEP, 0.0], [-_STEP, 0.0], [0.0, _STEP], [0.0, -_STEP]])
    flat = torch.zeros_like(light.to_light[:1])
    across, up = (move.to(flat)[:, None, None, None] + flat for move in moves.T)
    moved = uniform_radiance(uniform, light, (across, up))[0]
    right, left, above, below = moved.mean(1, keepdim=True).log()
    return torch.cat([right - left, above - below]) / (2.0 * _STEP)


def _shown_of_roughness(uniform: Uniform, light: FlashLight, flat: Tensor) -> Tensor:
    """(1, h, w) d log L / d logit(roughness), by a forward difference from `flat` (3, h, w)."""
    duller = uniform_radiance(uniform, light, duller=_STEP)[0]
    return (duller.mean(0, keepdim=True).log() - flat.mean(0, keepdim=True).log()) / _STEP


def _resized(picture: Tensor, size: tuple[int, ...]) -> Tensor:
    """Resize (C, H, W) bilinearly to (C, *size), with corners aligned."""
    return F.interpolate(picture[None], size=list(size), mode="bilinear", align_corners=True)[0]
