"""matcap: one phone flash photograph in, an endless generator of SVBRDF maps out.

    import matcap

    material = matcap.capture("leather.dng")
    maps = material.maps(1024, 1024, seed=7)

The names below are imported when first used, so that `import matcap` is instant.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from matcap.errors import MatcapError

if TYPE_CHECKING:
    from matcap.api import capture as capture
    from matcap.brdf.maps import MapSet as MapSet
    from matcap.export.mapset import MapSetInfo as MapSetInfo
    from matcap.export.mapset import read_mapset as read_mapset
    from matcap.export.mapset import write_mapset as write_mapset
    from matcap.model.material import Material as Material
    from matcap.photo.load import load_photo as load_photo
    from matcap.relight.render import relight as relight
    from matcap.synth.field import Field as Field

__version__ = "0.1.0"

# Each public name and the module it is defined in; "" for the callable packages of that name.
_HOMES = {
    "Field": "matcap.synth.field",
    "MapSet": "matcap.brdf.maps",
    "MapSetInfo": "matcap.export.mapset",
    "Material": "matcap.model.material",
    "capture": "",
    "load_photo": "matcap.photo.load",
    "read_mapset": "matcap.export.mapset",
    "relight": "",
    "write_mapset": "matcap.export.mapset",
}

__all__ = [
    "Field",
    "MapSet",
    "MapSetInfo",
    "MatcapError",
    "Material",
    "__version__",
    "capture",
    "load_photo",
    "read_mapset",
    "relight",
    "write_mapset",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'matcap' has no attribute '{name}'")
    home = _HOMES[name]
    return getattr(import_module(home), name) if home else import_module(f"matcap.{name}")


def __dir__() -> list[str]:
    return __all__
