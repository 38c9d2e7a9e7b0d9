"""Surroundings from pictures."""

import math

import numpy as np
import pytest
from relight_samples import flat

from matcap.errors import MatcapError
from matcap.export.exr import write_exr
from matcap.relight.environment import environment_of
from matcap.relight.render import Renderer, relight
from matcap.relight.scene import EnvironmentLight, Film, Scene, Surface
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
