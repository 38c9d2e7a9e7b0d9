"""The scene of a photograph: its camera and flash, for a picture to compare with it.

The same geometry as matcap.flash.light. FlashSetup's intensity includes the exposure, so
radiance 1 is the photograph's white.
"""

from __future__ import annotations

import torch

from matcap.flash.geometry import FlashSetup, camera_in_plane, setup_rotation, to_upright, unproject
from matcap.relight.scene import Camera, Film, PointLight, Scene, Surface, Vector


def photographed_scene(setup: FlashSetup, film: Film, *, endless: bool) -> Scene:
    """The scene with the photograph's camera and its flash as a point light.

    Args:
        film: of the picture, with the photograph's aspect ratio.
        endless: extend the plane to all that the camera sees; else it is the maps' rectangle.
    """
    place, light = (_vector(to_upright(setup, one)) for one in camera_in_plane(setup))
    # `turned`: the photograph is a portrait, so its up is the landscape's left.
    above = [-1.0, 0.0, 0.0] if setup.turned else [0.0, 1.0, 0.0]
    up = _vector(
        to_upright(setup, setup_rotation(setup).T @ torch.tensor(above, dtype=torch.float64))
    )
    middle = _vector(to_upright(setup, torch.tensor([*setup.vignetting_centre, 0.0])))
    camera = Camera(
        "perspective",
        place,
        fov=setup.fov,
        up=up,
        vignetting=setup.vignetting,
        vignetting_quartic=setup.vignetting_quartic,
        vignetting_centre=(middle[0], middle[1]),
    )
    surface = Surface(size=_seen(setup, film) if endless else None)
    return Scene(film, camera, surface, (PointLight(light, setup.intensity),))


def _seen(setup: FlashSetup, film: Film) -> float:
    """Side of a square around the origin that holds all that the picture shows of the plane."""
    long = max(film.width, film.height)
    x, y = film.width / long, film.height / long
    if setup.turned:
        x, y = y, x
    corners = torch.tensor([[-x, x, -x, x], [y, y, -y, -y]], dtype=torch.float64)
    return 2.0 * float(unproject(corners, setup)[:2].abs().max())


def _vector(tensor: torch.Tensor) -> Vector:
    x, y, z = tensor.tolist()
    return x, y, z
