"""Summary statistics of maps, and their errors against true maps of the same texels."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.files.rec709 import LUMINANCE

_STEEP = 3.0  # degrees: where normals are compared
_DARK = 1e-3  # of albedo


def map_statistics(maps: MapSet) -> dict[str, float]:
    """Mean angle of the normal from the plane's, degrees; contrast of albedo; mean roughness.

    The contrast is the standard deviation of the logarithm of diffuse albedo's luminance.
    """
    luminance = torch.tensor(LUMINANCE)[:, None, None] * maps.diffuse.float()
    return {
        "tilt": float(maps.normal[2].clamp(-1.0, 1.0).acos().rad2deg().mean()),
        "albedo": float((luminance.sum(0) + _DARK).log().std()),
        "roughness": float(maps.roughness.mean()),
    }


def map_errors(estimate: MapSet, true: MapSet, where: Tensor | None = None) -> dict[str, float]:
    """Errors over all texels, or over those of `where`, (H, W) bool, by name.

    normals: mean angle between normals, degrees, where the true tilt exceeds 3; flat: that of a
    flat normal map, the mean true tilt there; albedo: mean absolute difference of log albedo, after
    subtracting the median difference; roughness: mean absolute difference.
    """
    here = torch.ones(estimate.size[::-1], dtype=torch.bool) if where is None else where
    off = (true.normal.float() * estimate.normal).sum(0).clamp(-1.0, 1.0).acos().rad2deg()
    lean = true.normal[2].clamp(-1.0, 1.0).acos().rad2deg()
    steep = (lean > _STEEP) & here
    log = (estimate.diffuse.mean(0) + _DARK).log() - (true.diffuse.mean(0) + _DARK).log()
    return {
        "normals": float(off[steep].mean()),  # NaN of none
        "flat": float(lean[steep].mean()),
        "albedo": float((log - log[here].median())[here].abs().mean()),
        "roughness": float((estimate.roughness - true.roughness)[0][here].abs().mean()),
    }


def compared_numbers(estimate: MapSet, truths: Sequence[MapSet]) -> dict[str, float]:
    """map_statistics() of maps, and their means over true samples in texels of the same size."""
    shrunk = [map_statistics(shrunk_to(maps, estimate.texel_size)) for maps in truths]
    columns = {}
    for name, value in map_statistics(estimate).items():
        columns[name] = value
        columns[f"true {name}"] = sum(one[name] for one in shrunk) / len(shrunk)
    return columns


def shrunk_to(maps: MapSet, texel_size: float) -> MapSet:
    """Means over texels of a size, no finer than the maps'."""
    width, height = maps.size
    share = min(1.0, maps.texel_size / texel_size)
    size = (round(height * share), round(width * share))
    stacked: Tensor = F.interpolate(maps.stacked()[None].float(), size, mode="area")[0]
    return MapSet.from_stacked(stacked, maps.texel_size * width / size[1])
