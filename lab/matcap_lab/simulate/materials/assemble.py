"""From the fields of a procedural material to a MapSet."""

from __future__ import annotations

import numpy as np
import torch

from matcap.brdf.maps import MapSet
from matcap_lab.simulate.procedural import Canvas, Raster

_DARKEST = 0.004  # diffuse albedo of the darkest dielectrics
_SMOOTHEST = 0.05


def assemble(
    canvas: Canvas,
    diffuse: Raster,
    specular: Raster | float,
    roughness: Raster | float,
    height: Raster,
    darkest: float = _DARKEST,
) -> MapSet:
    """MapSet in float64 of fields that broadcast to (3, H, W) and (H, W), clipped to their ranges.

    F0 of shape (3, H, W) has a colour; `darkest` is the least diffuse albedo.
    """
    coloured = np.ndim(specular) == 3
    shape = (canvas.height, canvas.width)

    def stored(field: Raster | float, channels: int, low: float, high: float) -> torch.Tensor:
        full = np.broadcast_to(np.asarray(field, dtype=np.float64), (channels, *shape))
        return torch.from_numpy(np.clip(full, low, high))

    return MapSet(
        diffuse=stored(diffuse, 3, darkest, 0.95),
        specular=stored(specular, 3 if coloured else 1, 0.02, 1.0 if coloured else 0.98),
        roughness=stored(roughness, 1, _SMOOTHEST, 1.0),
        height=stored(height, 1, -np.inf, np.inf),
        texel_size=canvas.texel_size,
    )
