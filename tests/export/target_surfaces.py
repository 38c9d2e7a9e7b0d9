"""A target's surface against map sets, without an export."""

from dataclasses import fields

import torch

from matcap.export.shading import TargetSurface, compared, shine_all, thinning


def of_maps(maps) -> TargetSurface:
    """The surface with matcap's parameters and shading."""
    return TargetSurface(maps.diffuse, maps.specular, maps.roughness, maps.normal)


def every(surface, step) -> TargetSurface:
    """Every step-th texel of every step-th row, in float64."""
    values = {field.name: getattr(surface, field.name) for field in fields(surface)}
    return TargetSurface(
        **{
            name: value[..., ::step, ::step].double() if torch.is_tensor(value) else value
            for name, value in values.items()
        }
    )


def residual(maps, surface):
    """Residual of a surface as large as the maps against them."""
    step = thinning(*maps.size)
    return compared(shine_all(every(of_maps(maps), step)), every(surface, step))
