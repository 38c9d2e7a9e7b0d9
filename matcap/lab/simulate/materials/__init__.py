"""Procedural stationary materials: the same parameters, another realisation for every seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.lab.simulate.materials.named import cloth, granite, leather, plaster, rust, tile
from matcap.lab.simulate.materials.varied import RandomMaterial, random_material
from matcap.lab.simulate.procedural import Canvas

__all__ = ["MATERIALS", "RandomMaterial", "random_material", "realise"]

MATERIALS: Mapping[str, Callable[[Canvas], MapSet]] = MappingProxyType(
    {
        "leather": leather,
        "cloth": cloth,
        "granite": granite,
        "rust": rust,
        "plaster": plaster,
        "tile": tile,
    }
)


def realise(name: str, width: int, height: int, seed: int, texel_size: float) -> MapSet:
    """One realisation of a named material.

    A finer texel size over the same extent shows the same realisation in more detail.

    Args:
        name: a key of MATERIALS.
        width: texels.
        height: texels.
        seed: not negative; another seed is another realisation of the same material.
        texel_size: a texel's side in plane units.

    Returns:
        float64 maps (C, height, width) on the CPU.

    Raises:
        UsageError: no material of that name.
    """
    if name not in MATERIALS:
        raise UsageError.at(
            name, "there is no such material", f"choose from {', '.join(MATERIALS)}"
        )
    return MATERIALS[name](Canvas(width, height, texel_size, seed))
