"""matcap: one phone flash photograph in, an endless generator of SVBRDF maps out.

    import matcap

    material = matcap.capture("leather.dng")
    maps = material.maps(1024, 1024, seed=7)

The names are those of api.py, most of them imported when first used: `import matcap` is instant.

`capture` and `relight` are packages that can be called: a call is one of the function of that name
in api.py. A function in a package's place would hide its modules from
`import matcap.capture.settings as settings`, and a package of another name than its command, its
documentation and its tests would be one more word to know.
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from matcap import api

if TYPE_CHECKING:
    from matcap.api import *  # noqa: F403

__all__ = api.__all__
__version__ = api.__version__


def _can_be_called(name: str) -> None:
    """Let calls of a package be calls of the function of its name, which processes can be sent."""
    call = getattr(api, name)
    ways = {
        "__call__": lambda self, *args, **named: call(*args, **named),
        "__wrapped__": staticmethod(call),  # where inspect looks for parameters
        "__reduce__": lambda self: (import_module, (self.__name__,)),
    }
    import_module(f"matcap.{name}").__class__ = type("CallablePackage", (ModuleType,), ways)


for _name in ("capture", "relight"):
    _can_be_called(_name)


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module 'matcap' has no attribute '{name}'")
    return getattr(api, name)


def __dir__() -> list[str]:
    return __all__
