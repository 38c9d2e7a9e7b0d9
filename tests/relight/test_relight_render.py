"""Pictures of flat material under point lights."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from relight_samples import bumpy, flat

import matcap
from matcap.flash.geometry import plane_points
from matcap.flash.render import shade
from matcap.relight import render
from matcap.relight.scene import Camera, Film, PointLight, Scene, Surface, scene_from_light


def relight(source, scene, **options):
    """The plain reflectance on the undisplaced plane, which the references below know."""
    return render.relight(
        source,
        scene,
        effects="-multiscatter,-parallax,-shadows,-interreflection,-filtering",
        **options,
    )


@pytest.fixture
def maps():
    return bumpy()


def reference(maps, light) -> np.ndarray:
    """The flash renderer's picture, in float64, on the maps' own grid."""
    width, height = maps.size
    points = plane_points(0, 0, width, height, (width, height), dtype=torch.float64)
    camera = torch.tensor([0.0, 0.0, 1.0 / math.tan(math.radians(22.5))], dtype=torch.float64)
    place = torch.tensor(light.position, dtype=torch.float64)
    intensity = torch.tensor(light.intensity, dtype=torch.float64)
    picture = shade(maps.map(torch.Tensor.double), points, camera, place, intensity)
    return picture.movedim(0, -1).numpy()


@pytest.mark.parametrize("light", ["flash", "top", "left", "0.3,-0.2,0.1"])
def test_same_as_the_flash_renderer(maps, light):
    scene = scene_from_light(light)
    found = relight(maps, scene)
    assert found.shape == (48, 64, 3)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, reference(maps, scene.lights[0]), rtol=1e-4, atol=1e-6)


def test_a_film_of_its_own_reads_between_texels(maps):
    """Four pixels a texel: their average is nearly the picture of one pixel a texel."""
    scene = scene_from_light("top")
    whole = relight(maps, scene)
    fine = relight(maps, replace(scene, film=Film(256, 192)))
    average = fine.reshape(48, 4, 64, 4, 3).mean(axis=(1, 3))
    assert np.abs(average - whole).mean() < 0.02 * whole.mean()


def test_a_turned_camera_sees_the_same_plane(maps):
    """The same points seen straight on and along a detour through the general camera."""
    light = PointLight((0.5, 1.0, 2.0), (5.0, 5.0, 5.0))
    film = Film(64, 48)
    straight = relight(maps, Scene(film, None, Surface(size=None), (light,)))
    # A hair off the axis, so that the way of arbitrary cameras is taken.
    near = Camera(position=(1e-5, 0.0, Camera().position[2]))
    turned = relight(maps, Scene(film, near, Surface(size=None), (light,)))
    np.testing.assert_allclose(turned[2:-2, 2:-2], straight[2:-2, 2:-2], rtol=2e-3)


@pytest.mark.parametrize(
    ("position", "along", "top"),
    [
        ((0.0, 0.0, 2.4), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
        ((0.0, -0.5, 3.0), (0.0, 0.5, -3.0), (0.0, 0.0, -1.0)),
    ],
)
def test_a_camera_that_looks_along_its_up_still_has_a_top(maps, position, along, top):
    light = (PointLight((0.5, 1.0, 2.0), (5.0, 5.0, 5.0)),)
    one, other = (
        relight(maps, Scene(Film(64, 48), Camera(position=position, up=up), Surface(), light))
        for up in (along, top)
    )
    assert one.any()
    np.testing.assert_array_equal(one, other)


def test_orthographic_camera():
    """All pixels look straight down: a flat plane under a far light is evenly lit."""
    camera = Camera("orthographic", (0.0, 0.0, 5.0), scale=1.0)
    light = PointLight((0.0, 0.0, 1000.0), (1e6, 1e6, 1e6))
    picture = relight(flat(), Scene(Film(8, 8), camera, Surface(), (light,)))
    lobe = 0.04 / (4.0 * math.pi * 0.25**2)
    np.testing.assert_allclose(picture, 0.5 / math.pi + lobe, rtol=1e-4)


def test_nothing_beside_the_plane_and_nothing_from_behind():
    light = PointLight((0.0, 0.0, 2.0))
    picture = relight(flat(), Scene(Film(32, 16), None, Surface(size=1.0), (light,)))
    assert picture[:, 16].all()
    small = Camera(position=(0.0, 0.0, 10.0))
    picture = relight(flat(), Scene(Film(33, 33), small, Surface(size=1.0), (light,)))
    assert picture[16, 16].all()
    assert not picture[0].any() and not picture[:, -1].any()
    behind = Camera(position=(0.0, 0.0, -2.0))
    assert not relight(flat(), Scene(Film(8, 8), behind, Surface(), (light,))).any()
    below = PointLight((0.0, 0.0, -2.0))
    assert not relight(bumpy(), Scene(Film(8, 8), None, Surface(), (below,))).any()


def test_light_falls_off_with_distance_squared_and_adds_up(maps):
    def picture(*lights):
        return relight(maps, Scene(Film(64, 48), None, Surface(), lights))

    far, near = (
        relight(flat(1, 1), Scene(Film(1, 1), None, Surface(), (PointLight((0.0, 0.0, z)),))).mean()
        for z in (2.0, 1.0)
    )
    assert near / far == pytest.approx(4.0, rel=1e-6)
    one, two = PointLight((1.0, 0.5, 1.0)), PointLight((-1.0, 0.5, 2.0), (1.0, 2.0, 3.0))
    np.testing.assert_allclose(picture(one, two), picture(one) + picture(two), rtol=1e-5)
    np.testing.assert_array_equal(picture(one, one), 2.0 * picture(one))


def test_a_material_is_read_at_the_size_the_surface_needs(maps):
    asked = []

    class Material:
        texel_size = 2.0 / 64

        def maps(self, width, height, *, seed, x, y):
            asked.append((width, height, seed))
            return bumpy(width, height, seed)

    picture = relight(Material(), Scene(Film(64, 48), None, Surface(size=2.0), ()), seed=5)
    assert picture.shape == (48, 64, 3)
    assert asked == [(64, 48, 5)]


def test_the_public_name(maps):
    np.testing.assert_array_equal(matcap.relight(maps, "left"), render.relight(maps, "left"))
