"""The scene of a photograph: its own camera, flash and exposure, so that both can be compared.

matcap.flash.render says what the photograph showed; this is the same in the terms of a scene. What
the capture calls the flash's intensity holds the exposure, so radiance 1 is the photograph's white.
"""

from __future__ import annotations

import torch

from matcap.flash.geometry import FlashSetup, camera_in_plane, setup_rotation, stood, unproject
from matcap.relight.scene import Camera, Film, PointLight, Scene, Surface, Vector


def photographed_scene(setup: FlashSetup, film: Film, *, endless: bool) -> Scene:
    """The picture that the photograph's camera took by its flash.

    Args:
        setup: camera and flash.
        film: of the picture; its sides should be to each other as the photograph's.
        endless: the material goes on beyond what was photographed, so that all of the picture
            can be filled where the plane was tilted.
    """
    place, light = (_vector(stood(setup, one)) for one in camera_in_plane(setup))
    # The upright picture's up is the lying one's left.
    above = [-1.0, 0.0, 0.0] if setup.turned else [0.0, 1.0, 0.0]
    up = _vector(stood(setup, setup_rotation(setup).T @ torch.tensor(above, dtype=torch.float64)))
    camera = Camera(
        "perspective",
        place,
        fov=setup.fov,
        up=up,
        vignetting=setup.vignetting,
        vignetting_quartic=setup.vignetting_quartic,
    )
    surface = Surface(size=_seen(setup, film) if endless else None)
    return Scene(film, camera, surface, (PointLight(light, setup.intensity),))


def _seen(setup: FlashSetup, film: Film) -> float:
    """Side of a square of the plane, around its middle, that holds all of the picture."""
    long = max(film.width, film.height)
    x, y = film.width / long, film.height / long
    if setup.turned:
        x, y = y, x
    corners = torch.tensor([[-x, x, -x, x], [y, y, -y, -y]], dtype=torch.float64)
    return 2.0 * float(unproject(corners, setup)[:2].abs().max())


def _vector(tensor: torch.Tensor) -> Vector:
    x, y, z = tensor.tolist()
    return x, y, z
