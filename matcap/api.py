"""What a Python program calls first: a photograph to a material, maps to a picture.

Torch and what is heavy are imported when a function is called.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from matcap.brdf.maps import MapSet
    from matcap.model.material import Material
    from matcap.relight.render import MapSource
    from matcap.relight.scene import Scene


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
    from matcap.capture.pipeline import CaptureSettings, capture_file

    return capture_file(path, CaptureSettings(**settings)).material


def relight(
    source: MapSet | MapSource,
    scene: Scene | str = "top",
    **options: Any,  # noqa: ANN401
) -> NDArray[np.float32]:
    """A picture of a material in a scene.

    Args:
        source: maps, or a material to read them from.
        scene: the scene, or the name of a light, such as "top" (relight.scene.scene_from_light).
        options: seed, tolerance and effects of matcap.relight.render.relight.

    Returns:
        (H, W, 3) float32 radiance, linear Rec.709; 0 where there is no surface.

    Raises:
        MatcapError: a file of the scene is missing or broken, or an effect has no such name.

    Example:
        picture = matcap.relight(maps, "left")
    """
    from matcap.relight.render import relight as render

    return render(source, scene, **options)
