"""Maps from whatever a user points at: a material, a map set, or a folder with either."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from matcap.errors import MatcapError
from matcap.export.mapset import find_mapsets, read_mapset

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet


def open_maps(path: Path, *, size: tuple[int, int] = (1024, 1024), seed: int = 0) -> MapSet:
    """Maps of a material file, a map set's JSON file, or a folder.

    A folder's map set goes before its material.

    Args:
        path: what to open.
        size: (width, height) in texels, and
        seed: the realisation; both for a material only, since a map set has its own.

    Raises:
        MatcapError: nothing to open, more than one thing, or a broken file.
    """
    if path.is_dir() and not find_mapsets(path):
        materials = sorted(path.glob("*.matcap"))
        if len(materials) > 1:
            names = ", ".join(file.name for file in materials)
            raise MatcapError(
                f"there are {len(materials)} materials in this folder ({names})",
                where=str(path),
                remedy="name one of them",
            )
        if not materials:
            raise MatcapError(
                "there is no map set and no material in this folder",
                where=str(path),
                remedy="give a folder that matcap capture or matcap synth wrote",
            )
        path = materials[0]
    if path.suffix.lower() == ".matcap":
        from matcap.model.material import Material

        return Material.load(path).maps(*size, seed=seed)
    return read_mapset(path)[0]
