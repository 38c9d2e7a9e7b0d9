"""Scenes from files and from the shorthand of the command line."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from relight_samples import bumpy

from matcap.errors import MatcapError, UsageError
from matcap.relight.named import PRESETS, preset
from matcap.relight.render import relight
from matcap.relight.scene import (
    NAMED_LIGHTS,
    Camera,
    EnvironmentLight,
    Film,
    PointLight,
    RectangleLight,
    Scene,
    Surface,
    scene_from_light,
)
from matcap.relight.scenefile import parse_scene, read_scene

EVERYTHING = """
[film]
width = 64
height = 48
exposure = -1.5
transfer = "linear"
[camera]
type = "orthographic"
position = [0, 0, 3]
target = [0.0, 0.1, 0.0]
fov = 30
scale = 1.5
[surface]
type = "mesh"
size = 1.0
file = "shoe.obj"
repeat = 2.0
displacement = 0.5
[[light]]
type = "point"
position = [0, 1, 2]
intensity = [1, 2, 3]
[[light]]
type = "directional"
direction = [0, 0, 1]
irradiance = [1, 1, 1]
[[light]]
type = "sphere"
position = [0, 1, 2]
radius = 0.1
radiance = [1, 1, 1]
[[light]]
type = "rectangle"
position = [0, 1, 2]
normal = [0, 0, -1]
up = [0, 1, 0]
size = [0.5, 0.25]
radiance = [1, 1, 1]
[[light]]
type = "environment"
file = "sky.exr"
scale = 2.0
rotation = 90
[[light]]
type = "environment"
radiance = [0.1, 0.2, 0.3]
"""


def test_every_key_is_read(tmp_path):
    (tmp_path / "scene.toml").write_text(EVERYTHING)
    scene = read_scene(tmp_path / "scene.toml")
    assert scene.film == Film(64, 48, -1.5, "linear")
    assert scene.camera == Camera("orthographic", (0, 0, 3), (0, 0.1, 0), 30.0, 1.5)
    assert scene.surface == Surface("mesh", 1.0, tmp_path / "shoe.obj", 2.0, 0.5)
    point, directional, sphere, rectangle, sky, constant = scene.lights
    assert point == PointLight((0, 1, 2), (1, 2, 3))
    assert directional.direction == (0, 0, 1)
    assert sphere.radius == 0.1
    assert rectangle == RectangleLight((0, 1, 2), (0, 0, -1), (0, 1, 0), (0.5, 0.25), (1, 1, 1))
    assert sky == EnvironmentLight(tmp_path / "sky.exr", 2.0, 90.0)
    assert constant.radiance == (0.1, 0.2, 0.3)


def test_an_empty_file_is_the_defaults():
    assert parse_scene("") == Scene()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[flim]", r"unknown key 'flim'; did you mean 'film'"),
        ("[film]\nwidht = 3", r"\[film\]: unknown key 'widht'; did you mean 'width'"),
        ("[camera]\nfow = 3", r"did you mean 'fov'"),
        ("[surface]\ndisplace = 1.0", r"did you mean 'displacement'"),
        ("[[light]]\ntype='point'\nposition=[0,0,1]\nintesity=[1,1,1]", r"'intensity'"),
        ("[[light]]\ntype='point'\nposition=[0,0,1]\nradiance=[1,1,1]", r"unknown key 'radiance'"),
        ("[[light]]\ntype='pont'", r"\[\[light\]\] 1: unknown type 'pont'; did you mean 'point'"),
        ("[[light]]\nposition=[0,0,1]", r"a light needs a type"),
        ("[[light]]\ntype='sphere'\nposition=[0,0,1]", r"a sphere light needs radius"),
        ("[[light]]\ntype='environment'", r"either file or radiance"),
        ("[[light]]\ntype='rectangle'\nposition=[0,0,1]\nnormal=[0,1,0]", r"up is along"),
        ("[light]\ntype='point'", r"\[\[light\]\]"),
        ("[film]\nwidth = 0", r"width = 0 is wrong; give a whole number"),
        ("[film]\nwidth = 12.5", r"whole number"),
        ("[film]\nwidth = true", r"whole number"),
        ("[film]\nexposure = nan", r"give a number"),
        ("[film]\ntransfer = 'gamma'", r"\"srgb\" or \"linear\""),
        ("[camera]\nfov = 180", r"between 0 and 179"),
        ("[camera]\nposition = [0, 0]", r"three numbers"),
        ("[camera]\nposition = [0, 0, 0]", r"the same"),
        ("[surface]\nsize = -1", r"above 0"),
        ("[surface]\ntype = 'mesh'", r"needs its file"),
        ("[surface]\nfile = 'a.obj'", r"belongs to a mesh"),
        ("film = 3", r"not a table"),
        ("[film\n", r"this is not TOML"),
    ],
)
def test_mistakes_are_named(text, message):
    with pytest.raises(MatcapError, match=message) as caught:
        parse_scene(text)
    assert str(caught.value).startswith("scene")


def test_files_that_are_no_scenes(tmp_path):
    with pytest.raises(MatcapError, match="no such file"):
        read_scene(tmp_path / "none.toml")
    (tmp_path / "a.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MatcapError, match="not a readable text file"):
        read_scene(tmp_path / "a.toml")
    with pytest.raises(MatcapError, match="not a readable text file"):
        read_scene(tmp_path)


@pytest.mark.parametrize("name", sorted(NAMED_LIGHTS))
def test_named_lights_expose_white_as_white(name):
    (light,) = scene_from_light(name).lights
    squared = sum(c * c for c in light.position)
    cosine = light.position[2] / math.sqrt(squared)
    assert light.intensity[0] / squared * cosine / math.pi == pytest.approx(1.0)


def test_a_light_in_numbers():
    (light,) = scene_from_light("0.5,1,1,20").lights
    assert light == PointLight((0.5, 1.0, 1.0), (20.0, 20.0, 20.0))
    (light,) = scene_from_light(" -1, 1, 2").lights
    assert light.position == (-1.0, 1.0, 2.0)


@pytest.mark.parametrize("text", ["", "sun", "1,2", "1,2,3,4,5", "a,b,c", "0,0,nan", "0,0,inf"])
def test_what_is_no_light(text):
    with pytest.raises(UsageError, match="is not a light; give flash, top, left or x,y,z"):
        scene_from_light(text)


@pytest.mark.parametrize(("text", "message"), [("0,1,0", "above"), ("0,1,2,-1", "negative")])
def test_lights_that_cannot_be(text, message):
    with pytest.raises(UsageError, match=message):
        scene_from_light(text)


FILES = sorted((Path(__file__).parents[2] / "examples" / "scenes").glob("*.toml"))
SCENES = [(path.stem, read_scene(path)) for path in FILES] + [(n, preset(n)) for n in PRESETS]


@pytest.mark.parametrize(("name", "scene"), SCENES, ids=[name for name, _ in SCENES])
def test_it_shows_something_well_exposed(name, scene):
    film = scene.film or Film()
    small = replace(scene, film=replace(film, width=24, height=18))
    picture = relight(bumpy(64, 64), small) * film.gain
    assert np.isfinite(picture).all()
    shown = picture[picture.max(axis=-1) > 0]
    assert len(shown) > 50
    assert 0.05 < np.median(shown) < 1.0


def test_there_are_examples():
    assert len(FILES) >= 5
