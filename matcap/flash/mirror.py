"""Fill of masked texels of a plane by mirrored neighbours, relit for their new place.

Without relighting they would have the shading of another place, which would bias networks and
filters whose support includes masked texels.
"""

from __future__ import annotations

from dataclasses import replace

import torch
import torch.nn.functional as F

from matcap.flash.geometry import plane_points
from matcap.flash.light import FlashLight
from matcap.flash.plane import Plane
from matcap.flash.uniform import Uniform, uniform_radiance
from matcap.photo.left_out import mirrored

_THIN = 8  # subsampling, texels, of the uniform material's radiance, which is smooth


@torch.no_grad()
def lit_mirror(plane: Plane, uniform: Uniform) -> Plane:
    """Fill masked texels by mirrored ones, times the ratio of the uniform material's radiance.

    Args:
        plane: the photograph; returned unchanged without masked texels.
        uniform: its coarse fit.
    """
    if plane.left_out is None:
        return plane
    width, height = plane.size
    points = plane_points(0, 0, width, height, (width, height), dtype=torch.float32)
    size = [max(2, -(-side // _THIN)) for side in (height, width)]
    thin = F.interpolate(points[None], size=size, mode="bilinear", align_corners=True)[0]
    radiance = uniform_radiance(uniform, FlashLight.of(uniform.setup, thin))[0]
    flat = F.interpolate(radiance[None], size=[height, width], mode="bilinear", align_corners=True)[
        0
    ].clamp_min(1e-6)
    rows, columns = (torch.from_numpy(at) for at in mirrored(plane.left_out.numpy()))
    shown = plane.linear[:, rows, columns] * (flat / flat[:, rows, columns])
    return replace(plane, linear=torch.where(plane.left_out, shown, plane.linear))
