"""matcap: one phone flash photograph in, an endless generator of SVBRDF maps out.

    import matcap

    material = matcap.capture("leather.dng")
    maps = material.maps(1024, 1024, seed=7)

The names below are imported when first used, so that `import matcap` is instant.

`capture` and `relight` are functions, and packages of those names hold what they do. Importing a
package's submodule binds the package here, but only the first time: so both are imported before
the functions take their names. Import from the packages with `from matcap.capture.pipeline import
CaptureSettings`; the other form, `matcap.capture.pipeline`, would look in the function.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from matcap.errors import MatcapError
from matcap.version import __version__

for _package in ("capture", "relight"):
    import_module(f"matcap.{_package}")

from matcap.api import capture, relight  # noqa: E402  # after the packages, see above

if TYPE_CHECKING:
    from matcap.brdf.folder import MapSetInfo as MapSetInfo
    from matcap.brdf.folder import read_mapset as read_mapset
    from matcap.brdf.folder import write_mapset as write_mapset
    from matcap.brdf.maps import MapSet as MapSet
    from matcap.model.field import Field as Field
    from matcap.model.material import Material as Material
    from matcap.photo.load import load_photo as load_photo

# Each name that is imported when first used, and the module it is defined in.
_HOMES = {
    "Field": "matcap.model.field",
    "MapSet": "matcap.brdf.maps",
    "MapSetInfo": "matcap.brdf.folder",
    "Material": "matcap.model.material",
    "load_photo": "matcap.photo.load",
    "read_mapset": "matcap.brdf.folder",
    "write_mapset": "matcap.brdf.folder",
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
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
