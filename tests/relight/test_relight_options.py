"""`matcap relight`, with real files."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from relight_samples import bumpy

from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.cli.main import main
from matcap.files.exr import read_exr
from matcap.files.srgb import srgb_picture

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
    assert (code, out) == (0, "")
    assert "a.png" in err
    assert cv2.imread("a.png").shape == (16, 24, 3)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "m", "scene.toml"]


def test_exr_is_radiance_and_png_is_exposed_codes(run):
    assert run("m", "--scene", "scene.toml", "-o", "a.exr", "-q")[0] == 0
    assert run("m", "--scene", "scene.toml", "-o", "a.png", "-q")[0] == 0
    radiance = read_exr(Path("a.exr")).pixels
    assert radiance.shape == (16, 20, 3)
    codes = cv2.imread("a.png")[..., ::-1]
    np.testing.assert_array_equal(codes, np.rint(srgb_picture(radiance / 2.0) * 255))


def test_explain_and_json(run):
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


def test_the_map_of_tiles_shows_a_panel_for_each_effect_that_ran(run, tmp_path):
    code, _, _ = run("m", "--light", "left", "--explain-map", "where.png", "-o", "a.png")
    assert code == 0
    where = cv2.imread("where.png")
    assert where is not None and where.shape[1] > 3 * 24 and where.any()
    code, _, err = run("m", "--explain-map", "where.exr", "-o", "b.png")
    assert (code, "unknown map" in err, (tmp_path / "b.png").exists()) == (
        2,
        True,
        False,
    )


def test_tolerance_and_effects_reach_the_plan(run):
    plans = [
        json.loads(run("m", "--json", "-o", f"{tolerance}.png", "--tolerance", tolerance)[1])[
            "plan"
        ]
        for tolerance in ("0", "1e9")
    ]
    assert sum(row["on"] for row in plans[0]) > 0
    assert not any(row["on"] for row in plans[1])


def test_animations(run):
    options = ("--size", "16x12", "--animate", "light-orbit", "--frames", "3", "-q")
    for out in ("a.gif", "a.mp4", "b.exr"):
        assert run("m", *options, "-o", out)[0] == 0
    with Image.open("a.gif") as gif:
        assert gif.n_frames == 3
    video = cv2.VideoCapture("a.mp4")
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 3
    video.release()
    frames = [read_exr(Path(f"b_{i:04d}.exr")).pixels for i in range(3)]
    assert frames[0].shape == (12, 16, 3)
    assert not np.array_equal(frames[0], frames[1])


def test_turntable_ends_where_it_began(run):
    options = ("--scene", "turntable", "--size", "12", "--animate", "turntable", "-q")
    assert run("m", *options, "--frames", "2", "-o", "b.exr")[0] == 0
    assert read_exr(Path("b_0001.exr")).pixels.any()


def test_sheet(run):
    assert run("m", "--sheet", "3x2", "--size", "10x8", "-o", "a.png", "-q")[0] == 0
    assert cv2.imread("a.png").shape == (16, 30, 3)


def test_foreign_maps(run, tmp_path):
    folder = tmp_path / "bricks"
    folder.mkdir()
    cv2.imwrite(str(folder / "Bricks_Color.png"), np.full((8, 8, 3), 128, dtype=np.uint8))
    cv2.imwrite(str(folder / "Bricks_Normal.png"), np.full((8, 8, 3), 128, dtype=np.uint8))
    code, _, err = run("--maps-from", "bricks", "-o", "a.png")
    assert code == 0
    assert "which way green points" in err
    assert cv2.imread("a.png").shape == (8, 8, 3)
    assert "green" not in run("--maps-from", "bricks", "--normal", "dx", "-o", "b.png")[2]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("m", "-o", "a.gif"), 2, "use .png or .exr"),
        (("m", "-o", "a.png", "--animate", "light-orbit"), 2, "use .gif, .mp4 or .exr"),
        (("m", "--light", "sun"), 2, "is not a light"),
        (("m", "--scene", "nowhere"), 2, "there is no such scene"),
        (("m", "--scene", "nowhere.toml"), 3, "no such file"),
        (("m", "--scene", "scene.toml", "--light", "top"), 2, "its own lights"),
        (("m", "--effects", "+shadow"), 2, "is not an effect to switch"),
        (
            ("m", "--sheet", "2x2", "--animate", "light-orbit", "-o", "a.gif"),
            2,
            "--sheet one picture",
        ),
        (("nowhere",), 3, "no such file"),
        (("--maps-from", "nowhere"), 3, "no such folder"),
    ],
)
def test_mistakes(run, tmp_path, arguments, code, message):
    found, out, err = run(*arguments)
    assert found == code
    assert message in err
    assert len(err.strip().splitlines()) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m", "scene.toml"]
