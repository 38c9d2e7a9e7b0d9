"""What a Python program calls first: a photograph to a material, maps to a picture.

`matcap.capture` and `matcap.relight` are packages, and callable: `matcap.capture("photo.dng")`
works whether or not a submodule of theirs has been imported before.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matcap.model.material import Material


def capture(path: str | Path, **settings: Any) -> Material:  # noqa: ANN401
    """Turn a flash photograph into a material.

    Args:
        path: RAW (DNG and others), JPEG, PNG or TIFF.
        settings: fields of matcap.capture.pipeline.CaptureSettings: preset, steps, time_limit
            (seconds), detail (texels along the long side), fov (degrees), seed, prior.

    Raises:
        MatcapError: the file is not a photograph that a material can be made from.
        TypeError: an unknown setting.

    Example:
        m = matcap.capture("leather.dng", preset="draft")
        maps = m.maps(1024, 1024, seed=7)
    """
    from matcap.capture.pipeline import CaptureSettings, capture_photo
    from matcap.photo.load import load_photo

    chosen = CaptureSettings(**settings)
    photo = load_photo(path, long_side=chosen.most_detail, fov=chosen.fov, noise=chosen.tunes)
    return capture_photo(photo, chosen).material


def callable_package(name: str, function: Callable[..., Any]) -> None:
    """Let the imported package `name` be called as `function`.

    Importing a submodule binds its package's name in `matcap`, over any function of that name;
    so the package itself must answer the call.
    """
    package = type(
        "CallablePackage", (ModuleType,), {"__call__": staticmethod(function), "__slots__": ()}
    )
    sys.modules[name].__class__ = package
