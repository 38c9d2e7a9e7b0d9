"""Surroundings from pictures."""

import math

import loop_calls
import numpy as np
import pytest
from relight_samples import flat

from matcap.errors import MatcapError
from matcap.files.exr import write_exr
from matcap.relight.environment_map import environment_of
from matcap.relight.render import Renderer, relight
from matcap.relight.scene import DirectionalLight, EnvironmentLight, Film, Scene, Surface
from matcap.relight.vectors import vec


def sky_file(tmp_path, picture, name="sky.exr"):
    write_exr(tmp_path / name, picture.astype(np.float32), half=False)
    return tmp_path / name


def spot(tmp_path, column, row, shape=(32, 64)):
    picture = np.zeros((*shape, 3))
    picture[row, column] = 1.0
    return sky_file(tmp_path, picture)


@pytest.mark.parametrize(
    ("direction", "column", "row"),
    [
        ((0.0, 0.0, 1.0), 32, 16),  # the middle is what the plane faces
        ((0.0, 1.0, 0.0), 10, 0),  # the top is up
        ((-1.0, 0.0, 0.0), 48, 16),  # its right half is to the left of who looks out
    ],
)
def test_where_directions_are_in_the_picture(tmp_path, direction, column, row):
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
    scene = Scene(
        Film(4, 4), None, Surface(), (EnvironmentLight(sky_file(tmp_path, picture), scale=0.5),)
    )
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


def test_hdr_files_are_read(tmp_path):
    import cv2

    cv2.imwrite(str(tmp_path / "sky.hdr"), np.full((16, 32, 3), 2.0, dtype=np.float32))
    sky = environment_of(EnvironmentLight(tmp_path / "sky.hdr"))
    assert sky.brightest == pytest.approx(2.0, rel=0.01)


def test_broken_pictures(tmp_path):
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
    lights = (
        (EnvironmentLight(sky_file(tmp_path, picture)),),
        (
            DirectionalLight(sun.direction, (500.0 * solid,) * 3),
            EnvironmentLight(radiance=(0.02,) * 3),
        ),
    )
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
