"""Many pictures of one material: animations and light sheets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from matcap.relight.effects.bound import DEFAULT_TOLERANCE
from matcap.relight.named import light_orbit, sheet_lights, turntable
from matcap.relight.plan import Plan
from matcap.relight.render import Renderer, Rendering
from matcap.relight.scene import Scene

ANIMATIONS = {"light-orbit": light_orbit, "turntable": turntable}


def animate(
    renderer: Renderer,
    scenes: Sequence[Scene],
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    effects: str = "auto",
) -> Iterator[Rendering]:
    """Render scenes one by one; surface and film must be the renderer's."""
    for scene in scenes:
        yield renderer.render(scene, tolerance=tolerance, effects=effects)


def light_sheet(
    renderer: Renderer,
    columns: int,
    rows: int,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    effects: str = "auto",
) -> tuple[NDArray[np.float32], Plan]:
    """Render the material under each of sheet_lights(), instead of the scene's own lights.

    Returns:
        (rows H, columns W, 3) radiance, and the last picture's plan.
    """
    scene = renderer.scene
    renderings = [
        renderer.render(replace(scene, lights=(light,)), tolerance=tolerance, effects=effects)
        for light in sheet_lights(columns, rows)
    ]
    pictures = [one.radiance for one in renderings]
    lines = [np.hstack(pictures[i : i + columns]) for i in range(0, len(pictures), columns)]
    return np.vstack(lines), renderings[-1].plan
