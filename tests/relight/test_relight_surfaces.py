"""Surfaces, environments and edges."""

import math
from dataclasses import replace
from importlib import import_module

import loop_calls
import numpy as np
import pytest
import torch
from other_exr import write_other_exr
from relight_samples import bumpy, flat

from matcap.api import relight
from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap.files.exr import write_exr
from matcap.relight.block import Round
from matcap.relight.camera import vec, view_of
from matcap.relight.environment_map import environment_of
from matcap.relight.foreign.read import read_foreign
from matcap.relight.render import Renderer
from matcap.relight.scene import (
    Camera,
    DirectionalLight,
    EnvironmentLight,
    Film,
    PointLight,
    Scene,
    Surface,
)

# Sphere and cylinder; distant planes.

LAMBERT = "none,+diffuse"
AHEAD = Camera("orthographic", (0.0, 0.0, 5.0), scale=1.2)


def lambert(surface, light, camera=AHEAD, size=48, maps=None):
    scene = Scene(Film(size, size), camera, surface, (light,))
    return relight(maps or flat(diffuse=1.0), scene, effects=LAMBERT)[..., 0]


def test_a_sphere_is_shaded_by_its_normals():
    light = DirectionalLight((1.0, 2.0, 2.0), (math.pi,) * 3)
    picture = lambert(Surface("sphere", 2.0), light)
    screen = ((np.arange(48) + 0.5) / 24 - 1) * 1.2
    x, y = np.meshgrid(screen, -screen)
    inside = x * x + y * y < 1.0
    z = np.sqrt(np.maximum(1 - x * x - y * y, 0))
    expected = np.where(inside, np.maximum((x + 2 * y + 2 * z) / 3, 0), 0)
    np.testing.assert_allclose(picture, expected, atol=2e-4)


@pytest.mark.parametrize("cylinder", [False, True])
def test_no_camera_sees_farther_around_than_its_bound(cylinder):
    """Columns beyond it are not read from a material."""
    draw, shape, film, near = np.random.default_rng(5), Round(0.8, cylinder), Film(96, 96), 0
    for _ in range(40):
        place = draw.normal((0.0, 0.0, 2.0), (1.5, 0.5, 1.0))
        view = view_of(Camera(position=tuple(place), fov=50.0), film, 1.0)
        hits, most = shape.hits(view, 0, 96), shape.farthest_longitude(view)
        seen = np.abs(hits.place[0])[hits.seen] / shape.radius
        assert (seen <= most + 1e-6).all()
        near += most < math.pi and bool(len(seen)) and seen.max() > 0.9 * most
    assert near > 5


def test_a_cylinder_is_shaded_around_and_even_upwards():
    light = DirectionalLight((1.0, 0.0, 1.0), (math.pi,) * 3)
    picture = lambert(Surface("cylinder", 2.0), light)
    screen = ((np.arange(48) + 0.5) / 24 - 1) * 1.2
    inside = np.abs(screen) < 1.0
    z = np.sqrt(np.maximum(1 - screen**2, 0))
    row = np.where(inside, np.maximum((screen + z) / math.sqrt(2), 0), 0)
    np.testing.assert_allclose(picture[24], row, atol=2e-4)
    np.testing.assert_allclose(picture[inside], np.broadcast_to(row, (inside.sum(), 48)), atol=2e-4)
    assert not picture[~inside].any()


def test_the_material_keeps_its_size_on_a_sphere():
    """Stripes of a known width at the equator, counted in the picture."""
    maps = flat(32, 32)
    maps.diffuse[:, :, 16:] = 0.0  # one dark and one light stripe of one unit a repetition
    surface = Surface("sphere", 2.0, repeat=4.0)
    scene = Scene(Film(400, 3), AHEAD, surface, (DirectionalLight((0.0, 0.0, 1.0)),))
    row = relight(maps, scene, effects="none,+diffuse")[1, :, 0]
    x = ((np.flatnonzero(np.diff(row > 0.02 * row.max())) + 1) / 200 - 1) * 1.2
    longitude = np.arcsin(np.clip(x[np.abs(x) < 0.9], -1, 1))
    np.testing.assert_allclose(np.diff(longitude), 0.25, atol=0.03)


def test_far_bumps_become_roughness_instead_of_sparkle():
    """A pixel over 8 x 8 texels of a bumpy mirror: filtered it shows what they show on average."""
    maps = bumpy(256, 256, seed=2, relief=0.0)
    generator = np.random.default_rng(0)
    maps.height[:] = maps.height.new_tensor(generator.normal(0.0, 0.0008, (1, 256, 256)))
    grey = 0.0 * maps.roughness
    maps = replace(maps, diffuse=maps.diffuse * 0, specular=grey + 0.5, roughness=grey + 0.25)
    light = DirectionalLight((0.2, 0.1, 1.0), (1.0, 1.0, 1.0))

    def picture(size, effects):
        scene = Scene(Film(size, size), AHEAD, Surface(displacement=0.0), (light,))
        return relight(maps, scene, effects=effects)[..., 0]

    truth = picture(512, "none,+specular").reshape(32, 16, 32, 16).mean(axis=(1, 3))
    raw = picture(32, "none,+specular")
    filtered = picture(32, "none,+specular,+filtering")
    inside = truth > 0

    def error(found):
        return np.sqrt(((found - truth)[inside] ** 2).mean()) / truth[inside].mean()

    assert error(filtered) < 0.25 and error(filtered) < 0.25 * error(raw)


def test_filtering_does_nothing_near_by():
    maps = bumpy(32, 24)
    scene = Scene(Film(128, 96), None, Surface(), (PointLight((0.0, 1.0, 2.0)),))
    renderer = Renderer(maps, scene)
    with_it = renderer.render(effects="all").radiance
    without = renderer.render(effects="all,-filtering").radiance
    np.testing.assert_allclose(with_it, without, rtol=1e-4)


# Surroundings from pictures.


def sky_file(tmp_path, picture, name="sky.exr"):
    write_exr(tmp_path / name, picture.astype(np.float32), half=False)
    return tmp_path / name


@pytest.mark.parametrize(
    ("direction", "column", "row"),
    [
        ((0.0, 0.0, 1.0), 32, 16),  # the middle is what the plane faces
        ((0.0, 1.0, 0.0), 10, 0),  # the top is up
        ((-1.0, 0.0, 0.0), 48, 16),  # its right half is to the left of who looks out
    ],
)
def test_directions_map_to_the_right_pixels_of_the_environment(tmp_path, direction, column, row):
    picture = np.zeros((32, 64, 3))
    picture[max(row - 1, 0) : row + 1, column - 1 : column + 1] = 1.0
    if row == 0:
        picture[0] = 1.0
    sky = environment_of(EnvironmentLight(sky_file(tmp_path, picture)))
    at = tuple(np.full((1,), c) for c in vec(direction))
    np.testing.assert_allclose(sky.radiance(at), 1.0, atol=1e-5)
    opposite = tuple(np.full((1,), -c) for c in direction)
    np.testing.assert_allclose(sky.radiance(opposite), 0.0, atol=1e-5)


def test_rotation_turns_anticlockwise_seen_from_above(tmp_path):
    picture = np.zeros((32, 64, 3))
    picture[15:17, 31:33] = 1.0
    sky = environment_of(EnvironmentLight(sky_file(tmp_path, picture), rotation=90.0))
    # What stood at +z stands at +x.
    assert sky.radiance(tuple(np.full((1,), c) for c in (1.0, 0.0, 0.0)))[0] == pytest.approx(1.0)


def test_irradiance_of_a_cosine_sky_in_closed_form(tmp_path):
    """L = 1 + cos(angle to z): E on a normal along z from above is pi (1 + 2/3)."""
    v = (np.arange(64) + 0.5) / 64 * math.pi
    u = ((np.arange(128) + 0.5) / 128 - 0.5) * 2 * math.pi
    z = np.sin(v)[:, None] * np.cos(u)[None, :]
    picture = np.repeat((1.0 + z)[..., None], 3, axis=2)
    light = EnvironmentLight(sky_file(tmp_path, picture), scale=0.5)
    scene = Scene(Film(4, 4), None, Surface(), (light,))
    found = relight(flat(diffuse=1.0), scene, effects="none,+diffuse,+environment")
    np.testing.assert_allclose(found, 0.5 * (1.0 + 2.0 / 3.0), rtol=1e-3)


def test_a_picture_that_is_the_same_everywhere_is_the_constant(tmp_path):
    file = sky_file(tmp_path, np.full((16, 32, 3), 0.25))
    lights = (EnvironmentLight(file), EnvironmentLight(radiance=(0.25,) * 3))
    pictures = [
        relight(flat(), Scene(Film(4, 4), None, Surface(), (light,)), effects="all")
        for light in lights
    ]
    np.testing.assert_allclose(*pictures, rtol=1e-5)


def test_constant_surroundings_on_a_flat_plane_need_no_sampling():
    scene = Scene(Film(4, 4), None, Surface(), (EnvironmentLight(radiance=(0.5,) * 3),))
    assert not Renderer(flat(), scene).render().plan.on("environment")


def test_broken_environments_are_refused(tmp_path):
    with pytest.raises(MatcapError, match="no such file"):
        environment_of(EnvironmentLight(tmp_path / "none.exr"))
    (tmp_path / "bad.exr").write_text("no picture")
    with pytest.raises(MatcapError, match="not a readable picture"):
        environment_of(EnvironmentLight(tmp_path / "bad.exr"))
    file = sky_file(tmp_path, np.full((16, 32, 3), -1.0))
    with pytest.raises(MatcapError, match="no radiance"):
        environment_of(EnvironmentLight(file))


def test_a_small_sun_is_reflected_as_a_directional_light_would_be(tmp_path):
    """Its power in one texel, on a rough mirror: the lattice alone would miss or overrate it."""
    picture = np.full((64, 128, 3), 0.02)
    picture[30, 70] = 500.0
    sky = environment_of(EnvironmentLight(sky_file(tmp_path, picture)))
    (sun,) = sky.suns
    np.testing.assert_allclose(np.linalg.norm(sun.direction), 1.0, rtol=1e-6)
    edges = np.cos(np.array([30, 31]) * math.pi / 64)
    solid = (edges[0] - edges[1]) * 2 * math.pi / 128
    limit = float(sky.without_suns.brightest)
    np.testing.assert_allclose(sun.irradiance, (500.0 - limit) * solid, rtol=1e-3)
    surface, film = Surface(displacement=0.0), Film(16, 16)
    same = DirectionalLight(sun.direction, (500.0 * solid,) * 3)
    around = EnvironmentLight(sky_file(tmp_path, picture))
    lights = ((around,), (same, EnvironmentLight(radiance=(0.02,) * 3)))
    mirror = flat(diffuse=0.0, specular=0.9, roughness=0.5)
    effects = "all,-multiscatter"  # which surroundings cause as if they were even
    found, expected = (
        relight(mirror, Scene(film, None, surface, light), effects=effects) for light in lights
    )
    np.testing.assert_allclose(found, expected, rtol=0.01)


def test_octahedra_agree_with_the_picture_they_are_made_from(tmp_path):
    v = (np.arange(64) + 0.5) / 64 * math.pi
    u = ((np.arange(128) + 0.5) / 128 - 0.5) * 2 * math.pi
    smooth = 1.0 + np.sin(v)[:, None] * np.cos(u - 0.7)[None, :] * np.cos(v)[:, None]
    sky = environment_of(EnvironmentLight(sky_file(tmp_path, np.repeat(smooth[..., None], 3, 2))))
    towards = np.random.default_rng(0).normal(size=(3, 500))
    towards = tuple((towards / np.linalg.norm(towards, axis=0)).astype(np.float32))
    exact = sky.radiance(towards)
    for wide, rms in ((0.01, 5e-4), (0.1, 3e-3), (0.2, 1e-2)):
        found = loop_calls.radiance(sky.octahedra, towards, np.full(500, wide, dtype=np.float32))
        assert np.sqrt(((found - exact) ** 2).mean()) < rms


def test_octahedra_keep_all_light(tmp_path):
    picture = np.random.default_rng(1).random((32, 64, 3))
    octahedra = environment_of(EnvironmentLight(sky_file(tmp_path, picture))).octahedra
    flat_mean = [
        octahedra.atlas[int(top) + 1 : int(top + side) + 1, 1 : int(side) + 1].mean()
        for top, side in zip(octahedra.tops, octahedra.sides, strict=True)
    ]
    np.testing.assert_allclose(flat_mean, flat_mean[0], rtol=0.02)


@pytest.mark.parametrize("lit", [0, 1, 17, 300])
def test_the_search_for_suns_ends_whatever_the_sky(tmp_path, lit):
    """All black, one sun, a sky of stars too many for suns: and no light is lost."""
    picture = np.zeros((256, 512, 3))
    places = np.random.default_rng(0).permutation(np.arange(40, 216))[:lit]
    for index, row in enumerate(places):
        picture[row, 29 * index % 512] = 1.0 if index else 1e6
    sky = environment_of(EnvironmentLight(sky_file(tmp_path, picture)))
    edges = np.cos(np.arange(257) * math.pi / 256)
    solid = (edges[:-1] - edges[1:]) * 2.0 * math.pi / 512
    whole = float((picture[..., 0] * solid[:, None]).sum())
    calm = float((sky.without_suns.levels[0][..., 0] * solid[:, None]).sum())
    assert calm + sum(sun.irradiance[0] for sun in sky.suns) == pytest.approx(whole, rel=1e-5)
    assert len(sky.suns) == min(lit, 1) or (lit == 17 and len(sky.suns) <= 16)


# Numbers at the edge of what can be: the true picture, or one sentence with culprit and remedy.

FILM = Film(16, 12)


@pytest.fixture
def few_sums(monkeypatch):
    """Integrals over an environment as fine as sky() is, in a sixteenth of the time."""
    monkeypatch.setattr("matcap.relight.environment_map._SUMMED", 64)


def sky(folder, texel=None, value=1.0, calm=1.0, name="sky.exr"):
    """Surroundings of one radiance, a little uneven, but for a texel (row, column) of 32 x 64."""
    picture = np.full((32, 64, 3), calm, dtype=np.float32)
    picture[::2] *= 1.01
    if texel is not None:
        picture[texel] = value
    write_exr(folder / name, picture, half=False)
    return EnvironmentLight(folder / name)


def under(light, maps, kind="plane", **options):
    surface = Surface(kind, None if kind == "plane" else 1.0)
    return relight(maps, Scene(FILM, None, surface, (light,)), **options)


@pytest.mark.parametrize("value", [1e7, 1e17])
@pytest.mark.parametrize("effects", ["all", "-environment"])
@pytest.mark.usefixtures("few_sums")
def test_a_plane_does_not_see_what_shines_behind_it(tmp_path, value, effects):
    behind = sky(tmp_path, (16, 0), value)  # the border of the picture is -z
    maps = bumpy(relief=0.02)
    picture = under(behind, maps, effects=effects)
    expected = under(sky(tmp_path, name="calm.exr"), maps, effects=effects)
    np.testing.assert_allclose(picture, expected, atol=2e-5)


def test_a_texel_that_no_sum_could_hold_is_named(tmp_path):
    with pytest.raises(MatcapError, match=r"sky.exr: has a value of 1e\+30, too bright .*; clip"):
        under(sky(tmp_path, (16, 0), 1e30), flat())


@pytest.mark.parametrize("kind", ["plane", "sphere"])
@pytest.mark.usefixtures("few_sums")
def test_no_surroundings_give_negative_light(tmp_path, kind):
    for texel, value in (((16, 0), 1e6), ((16, 32), 1e17), ((12, 47), 1e17)):
        picture = under(sky(tmp_path, texel, value), bumpy(relief=0.02), kind, effects="all")
        assert np.isfinite(picture).all() and picture.min() >= 0.0


@pytest.mark.parametrize(
    ("light", "named"),
    [
        (PointLight((0.1, 0.0, 0.01), (1e38,) * 3), r"light 2 \(point\): 1e\+38"),
        (DirectionalLight((0.1, 0.0, 1.0), (1.0, 1e30, 1.0)), r"light 2 \(directional\): 1e\+30"),
        (EnvironmentLight(radiance=(1e25,) * 3), r"light 2 \(environment\): 1e\+25"),
    ],
)
def test_a_light_too_bright_is_named_with_its_remedy(light, named):
    scene = Scene(FILM, None, Surface(size=None), (PointLight((0.0, 0.0, 2.0)), light))
    with pytest.raises(MatcapError, match=f"{named} is too bright for single precision; give it"):
        relight(flat(), scene)


def test_a_picture_that_overflows_names_the_brightest_light(monkeypatch):
    monkeypatch.setattr(import_module("matcap.relight.scene"), "BRIGHTEST", np.inf)
    mirror = flat(specular=1.0, roughness=0.0)
    lights = (PointLight((0.0, 0.0, 2.0)), PointLight((0.0, 0.0, 1e-6), (1e36,) * 3))
    camera = Camera("orthographic", (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), scale=1e-6)
    with pytest.raises(MatcapError, match=r"light 2 \(point\): 1e\+36 is too bright"):
        relight(mirror, Scene(FILM, camera, Surface(size=None), lights), effects="all")


def test_a_light_in_the_surface_gives_finite_radiance():
    camera = Camera("orthographic", (0.0, 0.0, 3.0), (0.0, 0.0, 0.0), scale=1.0)
    scene = Scene(Film(5, 5), camera, Surface(size=None), (PointLight((0.0, 0.0, 0.0)),))
    assert np.isfinite(relight(flat(), scene, effects="all")).all()


def tall(height):
    """A piece of 8 x 8 texels whose height alternates."""
    field = height * (torch.arange(64).reshape(1, 8, 8) % 2).float()
    return MapSet(*(torch.full((n, 8, 8), 0.5) for n in (3, 1, 1)), field, 2.0 / 8)


@pytest.mark.parametrize("height", [1e7, 1e17, 1e27])
def test_heights_of_no_surface_are_refused_wherever_maps_leave(tmp_path, height):
    with pytest.raises(MatcapError, match="plane units, which no surface does; make the material"):
        Renderer(tall(height), Scene(FILM, None, Surface(), (PointLight((0.0, 0.0, 2.0)),)))
    with pytest.raises(MatcapError, match=r"height: its height reaches 1e\+.* plane units"):
        write_mapset(tall(height), tmp_path, MapSetInfo("a"))
    assert not list(tmp_path.iterdir())


def test_heights_that_no_ray_gets_through_are_refused_with_a_displacement_that_does():
    scene = Scene(FILM, None, Surface(), (PointLight((1.0, 0.0, 2.0)),))
    with pytest.raises(MatcapError, match="span 1e.03 plane units.*displacement below 0.02"):
        Renderer(tall(1e3), scene)
    lower = Scene(FILM, None, Surface(displacement=0.015), scene.lights)
    assert np.isfinite(Renderer(tall(1e3), lower).render(effects="all").radiance).all()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_maps_with_nan_are_not_reported_as_unreadable(tmp_path, value):
    pixels = np.full((8, 8, 3), 0.5, dtype=np.float32)
    pixels[3, 4] = value
    write_other_exr(tmp_path / "rock_diff.exr", {"RGB": pixels})
    with pytest.raises(MatcapError, match=r"rock_diff.exr: has values that are not finite .*; rep"):
        read_foreign(tmp_path)
