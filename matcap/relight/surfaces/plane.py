"""The plane z = 0."""

from __future__ import annotations

import numpy as np

from matcap.relight.camera import View
from matcap.relight.surfaces.hits import Hits
from matcap.relight.vectors import dot, scale, subtract, vec


def plane_hits(
    view: View, top: int, bottom: int, extent: tuple[float, float] | None = None
) -> Hits:
    """Where rows of pixels meet the plane.

    Args:
        view: the camera.
        top, bottom: rows of the picture, half open.
        extent: (width, height) outside which there is nothing.
    """
    if _frontal(view):
        distance = view.position[2] if view.perspective else 1.0
        across, down = view.screen(top, bottom)
        x = across * distance + view.position[0]
        y = down * distance + view.position[1]
        ahead = view.position[2] > 0.0
    else:
        origin, direction = view.rays(top, bottom)
        falling = direction[2] < -1e-9
        along = np.where(falling, -origin[2] / np.where(falling, direction[2], -1.0), -1.0)
        ahead = along > 0.0
        x, y = (np.where(ahead, origin[i] + along * direction[i], 0.0) for i in (0, 1))
    seen = np.asarray(ahead)
    if extent is not None:
        # A border pixel whose centre lies on the border is in.
        slack = 1.0 + 1e-9
        inside_x = np.abs(x) <= extent[0] / 2.0 * slack
        inside_y = np.abs(y) <= extent[1] / 2.0 * slack
        seen = seen & inside_x & inside_y
    all_seen = bool(seen.all())
    shape = (bottom - top, view.size[0])
    point = (x.astype(np.float32), y.astype(np.float32), np.zeros((1, 1), dtype=np.float32))
    if view.perspective:
        offset = subtract(vec(tuple(view.position)), point)
        squared = dot(offset, offset)
        inverse = 1.0 / np.sqrt(squared)
        to_view = scale(offset, inverse)
        footprint = view.pixel / inverse / np.maximum(to_view[2], np.float32(1e-6))
    else:
        to_view = vec(tuple(-view.axes[2]))
        footprint = np.asarray(view.pixel / max(-view.axes[2][2], 1e-6), dtype=np.float32)
    return Hits(
        point=point,
        frame=None,
        place=(x, y),
        to_view=to_view,
        seen=None if all_seen else np.broadcast_to(seen, shape),
        footprint=footprint,
    )


def _frontal(view: View) -> bool:
    """The camera looks straight down, the picture's sides along x and y."""
    return bool(np.abs(view.axes - np.diag([1.0, 1.0, -1.0])).max() < 1e-12)
