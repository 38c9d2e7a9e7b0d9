"""The Python interface: capture a material from a photograph, relight maps.

PyTorch and other slow imports happen when a function is called or a name first used.
"""

from __future__ import annotations

from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matcap.errors import MatcapError, UsageError
from matcap.files.names import MAKER_VERSION as __version__
from matcap.files.names import shown
from matcap.relight.effects import DEFAULT_TOLERANCE

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from matcap.brdf.folder import MapSetInfo, read_mapset, write_mapset
    from matcap.brdf.maps import MapSet
    from matcap.field.field import Field
    from matcap.field.material import Material
    from matcap.photo.load import load_photo
    from matcap.relight.render import MapSource
    from matcap.relight.scene import Scene

# Modules of the names that are imported when first used.
_HOMES = {
    "Field": "matcap.field.field",
    "MapSet": "matcap.brdf.maps",
    "MapSetInfo": "matcap.brdf.folder",
    "Material": "matcap.field.material",
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
        raise AttributeError(f"module 'matcap.api' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)


def capture(path: str | Path, *others: str | Path, **settings: Any) -> Material:  # noqa: ANN401
    """Capture a material from a flash photograph, or from several of the same surface.

    Args:
        path: RAW (DNG and others), JPEG, PNG or TIFF.
        others: more photographs of the same surface, from other positions (--together).
        settings: fields of matcap.capture.settings.CaptureSettings: preset, time_limit (seconds),
            detail (texels along the long side), fov (degrees), seed; with generator="decoder" also
            steps, target and prior.

    Raises:
        MatcapError: the file is not a photograph that a material can be made from, or a setting is
            unknown or not allowed.

    Example:
        m = matcap.capture("leather.dng", preset="instant")
        maps = m.maps(1024, 1024, seed=7)
    """
    from matcap.capture.run import capture_file
    from matcap.capture.settings import CaptureSettings

    for one in (path, *others):
        if not isinstance(one, str | PathLike):
            raise UsageError(
                f"{shown(one)} is not the path of a photograph",
                remedy="give a text or a Path; several photographs are separate arguments",
            )
    return capture_file(path, CaptureSettings.of(settings), others=others).material


def relight(
    source: MapSet | MapSource,
    scene: Scene | str = "top",
    *,
    seed: int = 0,
    tolerance: float = DEFAULT_TOLERANCE,
    effects: str = "auto",
) -> NDArray[np.float32]:
    """Render a material in a scene.

    Args:
        source: maps, or a material.
        scene: the scene, or the name of a light, such as "top" (relight.scene.scene_from_light).
        seed: of a material's realisation.
        tolerance: largest change by effects that are left out, in code values in [0, 1]; half an
            8-bit step by default.
        effects: "auto" leaves out effects below the tolerance; "all", "none", or "+x,-y".

    Returns:
        (H, W, 3) float32 radiance, linear Rec.709; 0 where there is no surface.

    Raises:
        MatcapError: a file of the scene is missing or broken, or an effect has no such name.

    Example:
        picture = matcap.relight(maps, "left")
    """
    from matcap.relight.render import Renderer
    from matcap.relight.scene import scene_from_light

    if isinstance(source, str | PathLike):
        raise UsageError(
            f"{shown(source)} is a path, not a material or maps",
            remedy="open it with matcap.Material.load or matcap.read_mapset",
        )
    scene = scene_from_light(scene) if isinstance(scene, str) else scene
    renderer = Renderer(source, scene, seed=seed)
    return renderer.render(tolerance=tolerance, effects=effects).radiance
