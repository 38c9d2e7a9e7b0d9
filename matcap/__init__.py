"""matcap: one phone flash photograph in, an endless generator of SVBRDF maps out.

    import matcap

    material = matcap.capture("leather.dng")
    maps = material.maps(1024, 1024, seed=7)

The names are those of api.py, most of them imported when first used: `import matcap` is instant.

`capture` and `relight` are functions, and packages of those names hold what they do. Importing a
package's submodule binds the package here, but only the first time: so both are imported before
the functions take their names. Import from the packages with `from matcap.capture.settings import
CaptureSettings`; the other form, `matcap.capture.settings`, would look in the function.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

for _package in ("capture", "relight"):
    import_module(f"matcap.{_package}")

from matcap import api  # noqa: E402  # after the packages, see above

if TYPE_CHECKING:
    from matcap.api import *  # noqa: F403

__all__ = api.__all__
__version__, capture, relight = api.__version__, api.capture, api.relight


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module 'matcap' has no attribute '{name}'")
    return getattr(api, name)


def __dir__() -> list[str]:
    return __all__
