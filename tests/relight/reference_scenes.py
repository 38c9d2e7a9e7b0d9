"""The scenes that matcap and Mitsuba 3 both render; see make_references.py."""

from dataclasses import replace

from relight_samples import bumpy

from matcap.relight.scene import (
    DirectionalLight,
    EnvironmentLight,
    Film,
    PointLight,
    RectangleLight,
    Scene,
    SphereLight,
    Surface,
)

FILM = Film(24, 18)
SKY_SIZE = (64, 128)

POINT = PointLight((0.7, 0.9, 1.1), (3.0, 4.0, 5.0))
LIGHTS = {
    "point": POINT,
    "directional": DirectionalLight((-1.0, 0.5, 0.8), (2.0, 1.5, 1.0)),
    "sphere": SphereLight((-0.8, 0.4, 1.2), 0.4, (6.0, 7.0, 8.0)),
    "rectangle": RectangleLight(
        (0.9, 0.2, 1.5), (-0.5, -0.2, -1.0), (0.0, 1.0, 0.2), (1.2, 0.8), (5.0, 4.0, 3.0)
    ),
}
# Low light on a strongly embossed, bright material: everything the relief can do shows.
LOW = PointLight((-1.6, 0.5, 0.7), (6.0, 6.0, 6.0))
RELIEF = 0.35


def flat_maps():
    """Varying maps and normals, to be laid out without displacement."""
    maps = bumpy(FILM.width, FILM.height, seed=3, relief=0.05)
    return replace(maps, roughness=0.3 + 0.6 * maps.roughness)


def embossed_maps():
    """Large bumps, bright and dull."""
    maps = bumpy(FILM.width, FILM.height, seed=5, relief=RELIEF)
    dull = 0.02 + 0.0 * maps.specular
    return replace(maps, diffuse=0.7 + 0.25 * maps.diffuse, specular=dull, roughness=0.8 + 0 * dull)


def flat_scene(light) -> Scene:
    """Only shading normals: no displacement."""
    return Scene(FILM, None, Surface(size=None, displacement=0.0), (light,))


def sky_scene(file) -> Scene:
    return flat_scene(EnvironmentLight(file, 1.0, 30.0))


def embossed_scene() -> Scene:
    return Scene(FILM, None, Surface(size=None), (LOW,))
