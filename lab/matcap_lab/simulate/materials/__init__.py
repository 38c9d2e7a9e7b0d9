"""Procedural stationary materials: the same parameters, another realisation for every seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap_lab.simulate.materials.named import cloth, granite, leather, plaster, rust, tile
from matcap_lab.simulate.materials.varied import RandomMaterial, random_material
from matcap_lab.simulate.procedural import Canvas

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
    """One realisation of a material of MATERIALS, float64 (C, height, width).

    A seed, not negative, is a realisation; a finer texel size (plane units) over the same extent
    shows the same one in more detail.

    Raises:
        UsageError: no material of that name.
    """
    if name not in MATERIALS:
        raise UsageError.at(
            name, "there is no such material", f"choose from {', '.join(MATERIALS)}"
        )
    return MATERIALS[name](Canvas(width, height, texel_size, seed))
