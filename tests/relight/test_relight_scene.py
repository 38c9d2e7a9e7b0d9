"""Scenes, options, photographed scenes."""

import json
import math
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from relight_samples import bumpy, flat
from simulated.photographs import PhoneCamera, take

from matcap.api import relight
from matcap.brdf.folder import PIECE, SETUP, MapSetInfo, write_mapset
from matcap.brdf.maps import MapSet
from matcap.cli.main import main
from matcap.errors import MatcapError, UsageError
from matcap.files.color import srgb_encode, srgb_picture
from matcap.files.exr import read_exr
from matcap.flash.geometry import FlashSetup, unproject
from matcap.flash.light import render_flash, render_rectified
from matcap.relight.effects import DEFAULT_TOLERANCE
from matcap.relight.render import Renderer
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
from matcap.relight.scenefile import PRESETS, parse_scene, photographed_scene, preset, read_scene

# Scenes from files and from the shorthand of the command line.

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
type = "sphere"
size = 1.0
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
    assert scene.surface == Surface("sphere", 1.0, 2.0, 0.5)
    point, directional, sphere, rectangle, sky, constant = scene.lights
    assert point == PointLight((0, 1, 2), (1, 2, 3)) and directional.direction == (0, 0, 1)
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
        ("[camera]\ntype = 'orthographic'\nscale = 0", r"above 0"),
        ("[[light]]\ntype='environment'\nfile = ''", r"give a file name"),
        ("[surface]\nsize = [1.0]", r"give a number"),
        ("film = 3", r"not a table"),
        ("[film\n", r"this is not TOML"),
    ],
)
def test_mistakes_are_named(text, message):
    with pytest.raises(MatcapError, match=message) as caught:
        parse_scene(text)
    assert str(caught.value).startswith("scene")


def test_files_that_are_no_scenes_are_refused(tmp_path):
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


def test_a_light_is_given_by_numbers():
    (light,) = scene_from_light("0.5,1,1,20").lights
    assert light == PointLight((0.5, 1.0, 1.0), (20.0, 20.0, 20.0))
    (light,) = scene_from_light(" -1, 1, 2").lights
    assert light.position == (-1.0, 1.0, 2.0)


NO_LIGHT = "is not a light; choose from flash, .*bottom or x,y,z"


@pytest.mark.parametrize(
    ("text", "message"),
    [(one, NO_LIGHT) for one in ("", "sun", "1,2", "1,2,3,4,5", "a,b,c", "0,0,nan", "0,0,inf")]
    + [("rigth", "did you mean 'right'"), ("0,1,0", "not above"), ("0,1,2,-1", "negative")],
)
def test_malformed_and_impossible_lights_are_refused(text, message):
    with pytest.raises(UsageError, match=message):
        scene_from_light(text)


@pytest.mark.parametrize(("one", "other"), [("left", "right"), ("top", "bottom")])
def test_named_lights_come_from_all_four_sides(one, other):
    (x, y, z), (u, v, w) = NAMED_LIGHTS[one], NAMED_LIGHTS[other]
    assert (x, y, z) == (-u, -v, w)


FILES = sorted((Path(__file__).parents[2] / "examples" / "scenes").glob("*.toml"))
SCENES = [(path.stem, read_scene(path)) for path in FILES] + [(n, preset(n)) for n in PRESETS]


@pytest.mark.parametrize(("name", "scene"), SCENES, ids=[name for name, _ in SCENES])
def test_a_named_scene_is_well_exposed(name, scene):
    film = scene.film or Film()
    small = replace(scene, film=replace(film, width=24, height=18))
    picture = relight(bumpy(64, 64), small) * film.gain
    assert np.isfinite(picture).all()
    shown = picture[picture.max(axis=-1) > 0]
    assert len(shown) > 50 and 0.05 < np.median(shown) < 1.0


def test_every_example_scene_is_valid():
    assert len(FILES) >= 5


# `matcap relight`, with real files.

SCENE = """
[film]
width = 20
height = 16
exposure = -1.0
[[light]]
type = "point"
position = [0.0, 1.0, 2.0]
intensity = [9.0, 9.0, 9.0]
"""


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run the command in a folder with a map set `m`; gives code, out and err."""
    write_mapset(bumpy(24, 16), tmp_path / "m", MapSetInfo("bumpy"))
    (tmp_path / "scene.toml").write_text(SCENE)
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        code = main(["relight", *arguments])
        said = capsys.readouterr()
        return code, said.out, said.err

    return call


def test_default_picture_is_one_pixel_a_texel(run, tmp_path):
    code, out, err = run("m", "-o", "a.png")
    assert (code, out) == (0, "") and "a.png" in err and cv2.imread("a.png").shape == (16, 24, 3)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "m", "scene.toml"]


def test_exr_holds_radiance_and_png_exposed_code_values(run):
    assert run("m", "--scene", "scene.toml", "-o", "a.exr", "-q")[0] == 0
    assert run("m", "--scene", "scene.toml", "-o", "a.png", "-q")[0] == 0
    radiance = read_exr(Path("a.exr")).pixels
    assert radiance.shape == (16, 20, 3)
    codes = cv2.imread("a.png")[..., ::-1]
    np.testing.assert_array_equal(codes, np.rint(srgb_picture(radiance / 2.0) * 255))


def test_explain_prints_the_plan_as_text_and_json(run):
    code, out, _ = run("m", "--light", "left", "--explain", "-o", "a.png")
    assert code == 0
    lines = out.splitlines()
    assert lines[0].split() == ["effect", "tiles", "bound", "ms", "reason"]
    assert any(line.startswith("shadows") for line in lines)
    assert any(line.split()[:2] == ["area", "off"] for line in lines)
    code, out, err = run("m", "--json", "-o", "b.png", "--effects", "none,+diffuse")
    report = json.loads(out)
    assert (code, err, report["out"]) == (0, "", "b.png")
    assert [row["effect"] for row in report["plan"] if row["on"]] == ["diffuse"]


def test_tolerance_and_effects_reach_the_plan(run):
    plans = []
    for tolerance in ("0", "1e9"):
        said = run("m", "--json", "-o", f"{tolerance}.png", "--tolerance", tolerance)[1]
        plans.append(json.loads(said)["plan"])
    assert sum(row["on"] for row in plans[0]) > 0 and not any(row["on"] for row in plans[1])


def test_maps_of_other_programs_are_relit(run, tmp_path):
    folder = tmp_path / "bricks"
    folder.mkdir()
    cv2.imwrite(str(folder / "Bricks_Color.png"), np.full((8, 8, 3), 128, dtype=np.uint8))
    cv2.imwrite(str(folder / "Bricks_Normal.png"), np.full((8, 8, 3), 128, dtype=np.uint8))
    code, _, err = run("--maps-from", "bricks", "-o", "a.png")
    assert code == 0 and "which way green points" in err and cv2.imread("a.png").shape == (8, 8, 3)
    assert "green" not in run("--maps-from", "bricks", "--normal", "dx", "-o", "b.png")[2]
    code, _, err = run("--maps-from", "m", "-o", "c.png")
    assert code == 0 and "m: matcap's own map set" in err and "without --maps-from" in err
    assert "own map set" not in run("m", "-o", "d.png")[2]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("m", "-o", "a.gif"), 2, "use .png or .exr"),
        (("m", "--light", "sun"), 2, "is not a light"),
        (("m", "--scene", "nowhere"), 2, "there is no such scene"),
        (("m", "--scene", "nowhere.toml"), 3, "no such file"),
        (("m", "--scene", "scene.toml", "--light", "top"), 2, "its own lights"),
        (("m", "--effects", "+shadow"), 2, "is not an effect to switch"),
        (("m", "-o", "scene.toml/a.png"), 3, "a file stands where a folder is needed"),
        (("nowhere",), 3, "no such file or folder"),
        (("--maps-from", "nowhere"), 3, "no such folder"),
        (("m", "--maps-from", "m"), 2, "m is given too; leave one of both out"),
    ],
)
def test_wrong_options_are_one_sentence(run, tmp_path, arguments, code, message):
    found, out, err = run(*arguments)
    assert found == code and message in err and len(err.strip().splitlines()) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m", "scene.toml"]


# `--light flash` is the photograph again: matcap.flash.light's picture, from the same camera.

SETUP_OF_A_PHONE = FlashSetup(
    fov=64.0, offset=(0.1, -0.04, 0.02), intensity=(5.0, 4.0, 3.0), vignetting=0.4,
    vignetting_centre=(0.05, -0.2), vignetting_colour=(-0.1, -0.05, 0.15),
)  # fmt: skip
# What the flash renderer has, too.
SAME = "none,+diffuse,+specular,+falloff"


def relit(maps: MapSet, setup: FlashSetup, *, effects="auto", size=None):
    scene = photographed_scene(setup, Film(*(size or maps.size)), endless=False)
    return Renderer(maps, scene).render(effects=effects).radiance


@pytest.mark.parametrize("vignetting", [(0.4, 0.0), (0.0, 0.0), (-0.3, 0.0), (0.0, 0.9)])
def test_the_scene_of_an_untilted_photograph_renders_the_photograph(vignetting):
    maps = bumpy(64, 48, relief=0.02)
    first, second = vignetting
    setup = replace(SETUP_OF_A_PHONE, vignetting=first, vignetting_quartic=second)
    expected = render_rectified(maps, setup).movedim(0, -1).numpy()
    np.testing.assert_allclose(relit(maps, setup, effects=SAME), expected, rtol=2e-4)


@pytest.mark.parametrize("tilt", [(0.1, 0.0), (0.0, -0.12), (0.09, 0.13)])
@pytest.mark.parametrize("size", [(48, 36), (36, 48)])
def test_the_scene_of_a_tilted_photograph_renders_the_photograph(tilt, size):
    setup = replace(SETUP_OF_A_PHONE, tilt=tilt)
    maps = flat(64, 64)
    scene = photographed_scene(setup, Film(*size), endless=True)
    found = Renderer(maps, scene).render(effects=SAME).radiance
    long = max(size)
    across = (torch.arange(size[0], dtype=torch.float64) * 2 + 1 - size[0]) / long
    down = (size[1] - 1 - torch.arange(size[1], dtype=torch.float64) * 2) / long
    image = torch.stack([across.expand(size[1], -1), down[:, None].expand(-1, size[0])])
    points = unproject(image, setup)
    expected = render_flash(flat(*size).map(torch.Tensor.double), setup, points)
    expected = expected.movedim(0, -1).numpy()
    np.testing.assert_allclose(found, expected, rtol=2e-4)


def test_light_flash_renders_a_simulated_photograph():
    """Pixel by pixel as bright and as lit, through tilt, lens and automatic exposure."""
    camera = PhoneCamera(width=96, height=72, blur=0.01, supersampling=1)
    tilted = FlashSetup(offset=(0.08, 0.05, 0.0), tilt=(0.08, -0.05), vignetting=0.3)

    def card(width, height, texel):
        return replace(flat(width, height, roughness=0.4), texel_size=texel)

    shot = take(card, camera, tilted)
    scene = photographed_scene(shot.setup, Film(96, 72), endless=True)
    found = Renderer(flat(64, 64, roughness=0.4), scene).render().radiance
    off = np.abs(srgb_encode(found) - srgb_encode(shot.linear))
    assert off.max() <= 3.0 / 255.0 and off.mean() <= 0.5 / 255.0


@pytest.mark.parametrize("vignetting", [(-1.5, 0.0), (0.0, -1.5), (-3.0, 1.5), (1.0, -2.0)])
def test_negative_vignetting_spends_no_more_than_the_tolerance(vignetting):
    maps = bumpy(48, 36, relief=1e-3)
    first, second = vignetting
    setup = replace(SETUP_OF_A_PHONE, vignetting=first, vignetting_quartic=second)
    off = srgb_encode(relit(maps, setup)) - srgb_encode(relit(maps, setup, effects="all"))
    assert np.abs(off).max() <= DEFAULT_TOLERANCE


def test_relight_flash_shows_the_exemplar_as_photographed(tmp_path, monkeypatch):
    maps = bumpy(24, 16, relief=0.0)
    monkeypatch.chdir(tmp_path)
    about = {"of": "the photographed piece", SETUP: asdict(SETUP_OF_A_PHONE)}
    write_mapset(maps, tmp_path / "m", MapSetInfo("m" + PIECE, provenance=about))
    options = ("--light", "flash", "--effects", SAME, "-q", "-o")
    assert main(["relight", "m", *options, "flash.exr"]) == 0
    expected = render_rectified(maps, SETUP_OF_A_PHONE).movedim(0, -1).numpy()
    found = read_exr(tmp_path / "flash.exr").pixels
    np.testing.assert_allclose(found, expected, rtol=5e-3, atol=1e-4)
    assert main(["relight", "m", *options, "small.png", "--size", "12x8"]) == 0
    assert cv2.imread("small.png").shape == (8, 12, 3)
    # Of maps whose photograph nobody knows, it is the light at the lens, as bright as the others.
    document = json.loads((tmp_path / "m" / f"m{PIECE}.json").read_text())
    document["provenance"] = {}
    (tmp_path / "m" / f"m{PIECE}.json").write_text(json.dumps(document))
    assert main(["relight", "m", *options, "named.exr"]) == 0
    assert np.abs(read_exr(tmp_path / "named.exr").pixels / expected - 1.0).max() > 0.1
