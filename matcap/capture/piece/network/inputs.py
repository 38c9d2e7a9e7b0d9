"""What the inverse network is told of a photograph, and how its answer is read as maps.

The photograph enters as the logarithm of its radiance over that of a uniform material in the same
setup (the coarse fit), beside the setup itself, told as what it *shows*: how log radiance changes
with slope and with roughness at every texel. So one network serves every field of view, flash and
tilt. Heights are in texels, slopes therefore physical at any detail.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.flash.geometry import camera_in_plane
from matcap.flash.uniform import Uniform, roughness_logit, uniform_radiance

_FARTHEST = 3.0  # log radiance beyond this from the uniform material's tells no more
_STEP = 0.03  # of slope and of logit roughness, for differences of radiance
_COARSER = 4  # what a uniform material shows is smooth: worked out on every fourth texel
_DAMPING = 0.1  # slope told per log radiance: bounded where relief does not show
_LOGITS = 7.0  # of roughness: 0.001 to 0.999


def network_inputs(linear: Tensor, valid: Tensor, uniform: Uniform, points: Tensor) -> Tensor:
    """(len(INPUTS), H, W) of a picture on the plane's grid.

    Args:
        linear: (3, H, W) scene-linear radiance.
        valid: (H, W) bool, seen and not clipped.
        uniform: the coarse fit.
        points: (3, H, W) plane points of the texels (flash.geometry.plane_points).
    """
    height, width = linear.shape[-2:]
    size = tuple(max(2, -(-side // _COARSER)) for side in (height, width))
    # From the first texel to the last one, whose points lie on a grid.
    thin = _resized(points, size)
    flat, diffuse = uniform_radiance(uniform, thin)
    shows_x, shows_y, shows_roughness = _shown(uniform, thin, flat)
    gloss = 1.0 - diffuse.mean(0, keepdim=True) / flat.mean(0, keepdim=True)
    _, light = (v.to(points)[:, None, None] for v in camera_in_plane(uniform.setup))
    tangent = (light - thin)[:2] / (light - thin)[2:]
    smooth = torch.cat([flat.log(), tangent, shows_x, shows_y, shows_roughness, gloss])
    smooth = _resized(smooth, (height, width))
    log = linear.clamp_min(1e-6).log() - smooth[:3]
    log = log.clamp(-_FARTHEST, _FARTHEST)
    told = smooth[5:7]
    # To first order: the slope along what shows that this departure in brightness would mean.
    relief = log.mean(0, keepdim=True) * told / (told.square().sum(0, keepdim=True) + _DAMPING**2)
    constants = torch.tensor(
        [
            roughness_logit(uniform.roughness) / 2.0,
            (math.log(uniform.specular) + 3.0) / 2.0,
            (math.log(sum(uniform.diffuse) / 3.0) + 1.5) / 2.0,
        ]
    ).to(points)
    return torch.cat(
        [
            log,
            valid[None].to(log),
            smooth[3:5],
            told.clamp(-4.0, 4.0),
            smooth[7:8].clamp(-2.0, 2.0),
            smooth[8:9],
            constants[:, None, None].expand(3, height, width),
            relief.clamp(-3.0, 3.0) * 0.5,
        ]
    )


def read_outputs(outputs: Tensor, uniform: Uniform, texel_size: float) -> MapSet:
    """Maps (..., C, H, W) of the network's outputs (..., >= OUTPUTS, H, W)."""
    albedo = torch.tensor(uniform.diffuse).to(outputs).log()[:, None, None]
    return MapSet(
        diffuse=(albedo + outputs[..., :3, :, :]).exp().clamp(0.001, 0.99),
        specular=(math.log(uniform.specular) + outputs[..., 3:4, :, :]).exp().clamp(0.005, 0.99),
        roughness=torch.sigmoid(
            (roughness_logit(uniform.roughness) + outputs[..., 4:5, :, :]).clamp(-_LOGITS, _LOGITS)
        ),
        height=outputs[..., 5:6, :, :] * texel_size,
        texel_size=texel_size,
    )


def departures(uniform: Uniform) -> Tensor:
    """(5,) what outputs depart from: logarithms of albedo and F0, logit of roughness."""
    albedo = [math.log(value) for value in uniform.diffuse]
    return torch.tensor([*albedo, math.log(uniform.specular), roughness_logit(uniform.roughness)])


def true_outputs(maps: MapSet, uniform: Uniform) -> Tensor:
    """The inverse of read_outputs: (..., OUTPUTS, H, W) departures of true maps."""
    albedo = torch.tensor(uniform.diffuse).to(maps.diffuse).log()[:, None, None]
    return torch.cat(
        [
            maps.diffuse.clamp(0.001, 0.99).log() - albedo,
            maps.specular.clamp(0.005, 0.99).log() - math.log(uniform.specular),
            maps.roughness.clamp(0.001, 0.999).logit() - roughness_logit(uniform.roughness),
            maps.height / maps.texel_size,
        ],
        dim=-3,
    )


def _shown(uniform: Uniform, points: Tensor, flat: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """What log radiance changes by with slope along x and y and with logit roughness, (1, h, w).

    Args:
        uniform: the coarse fit.
        points: (3, h, w).
        flat: (3, h, w) its radiance there.
    """
    # One picture above the other: small tensors cost by the call.
    moves = ((_STEP, 0.0), (-_STEP, 0.0), (0.0, _STEP), (0.0, -_STEP))
    height = points.shape[-2]
    x, y = (
        torch.tensor(v).to(points).repeat_interleave(height)[:, None]
        for v in zip(*moves, strict=True)
    )
    moved = uniform_radiance(uniform, points.repeat(1, len(moves), 1), (x, y))[0]
    right, left, up, down = moved.mean(0, keepdim=True).log().split(height, dim=-2)
    duller = uniform_radiance(uniform, points, duller=_STEP)[0].mean(0, keepdim=True).log()
    middle = flat.mean(0, keepdim=True).log()
    step = 2.0 * _STEP
    return (right - left) / step, (up - down) / step, (duller - middle) / _STEP


def _resized(picture: Tensor, size: tuple[int, ...]) -> Tensor:
    """(C, *size) of (C, H, W), corner texels on corner texels."""
    return F.interpolate(picture[None], size=list(size), mode="bilinear", align_corners=True)[0]
