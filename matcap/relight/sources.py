"""What `matcap relight` is pointed at: a map set, or a material that is read where it is seen."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from matcap.brdf.folder import find_mapsets
from matcap.model.opened import open_maps

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet
    from matcap.relight.render import MapSource


def open_source(path: Path) -> MapSet | MapSource:
    """A map set's maps, or a material itself.

    Raises:
        MatcapError: nothing to open, more than one thing, or a broken file.
    """
    if path.is_dir() and not find_mapsets(path):
        materials = sorted(path.glob("*.matcap"))
        # None or several: open_maps says so.
        path = materials[0] if len(materials) == 1 else path
    if path.suffix.lower() == ".matcap":
        from matcap.model.material import Material

        return Material.load(path)
    return open_maps(path)
