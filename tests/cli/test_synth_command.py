"""`matcap synth` and `matcap relight`."""

import filecmp
import json

import cv2
import numpy as np
import OpenImageIO as oiio
import pytest
import torch
from materials import a_material

from matcap.brdf.folder import MapSetInfo, read_mapset, write_mapset
from matcap.brdf.maps import MapSet
from matcap.field.field import Field
from matcap.field.material import Material
from matcap.field.plane import BLOCK
from matcap.files.exr import read_exr

# `matcap synth`: what it writes and what it refuses, with a small real material.


@pytest.fixture
def material(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "leather.matcap"
    a_material("leather", 1, across=512, provenance={"made": "up"}).save(path)
    return path


def assert_stored(maps, field):
    """Equal but for half float."""
    for kind in ("diffuse", "specular", "roughness", "height"):
        assert torch.allclose(getattr(maps, kind), getattr(field, kind), rtol=1e-3, atol=1e-7)


def test_synth_writes_a_rectangle_of_the_field(matcap, material, tmp_path):
    said = matcap("synth", material, "--region", "100,-50,24,8", "--seed", 7, "-o", "set")
    assert (said.code, said.out) == (0, "")
    maps, document = read_mapset(tmp_path / "set")
    assert (document["x"], document["y"], document["seed"]) == (100, -50, 7)
    assert document["provenance"] == {"made": "up"}
    assert_stored(maps, Field(Material.load(material), 7).read(100, -50, 24, 8))
    names = {"diffuse", "specular", "roughness", "height", "normal"}
    files = {f"leather_{name}.exr" for name in names} | {"leather.json", "leather_preview.png"}
    assert {file.name for file in (tmp_path / "set").iterdir()} == files


def test_the_default_folder_is_named_after_the_request(matcap, material, tmp_path):
    assert matcap("synth", material, "--size", "40x8", "--seed", 3, "-q").err == ""
    assert read_mapset(tmp_path / "leather_40x8_seed3")[0].size == (40, 8)


@pytest.mark.parametrize(
    ("tile", "repeats"), [(["--tile"], "xy"), (["--tile", "x"], "x"), (["--tile", "y"], "y")]
)
def test_adjacent_rectangles_join_exactly(matcap, material, tmp_path, tile, repeats):
    # The lone --tile stands before the material: it must not take it for its value.
    assert matcap("synth", *tile, material, "--size", "48x32", "-o", "set", "-q").code == 0
    maps, document = read_mapset(tmp_path / "set")
    period = (48 if "x" in repeats else None, 32 if "y" in repeats else None)
    assert document["period"] == list(period)
    assert document["periodic"] is maps.periodic is (repeats == "xy")
    assert_stored(maps, Field(Material.load(material), 0, period).read(0, 0, 48, 32))


def test_a_texture_set_is_one_field(matcap, material, tmp_path):
    options = ["--udim", "2x2", "--region", "5,7,32,16"]
    assert matcap("synth", material, *options, "-o", "set", "-q").code == 0
    document = json.loads((tmp_path / "set/leather.json").read_text())
    assert document["udim"] == [2, 2]
    field = Field(Material.load(material), 0).read(5, 7, 64, 32).roughness[0].numpy()
    pattern = str(tmp_path / "set" / document["maps"]["roughness"]["file"])
    for number, (x, y) in {1001: (0, 16), 1002: (32, 16), 1011: (0, 0), 1012: (32, 0)}.items():
        tile = oiio.ImageBuf(pattern.replace("<UDIM>", str(number))).get_pixels("float")[..., 0]
        assert np.allclose(tile, field[y : y + 16, x : x + 32], rtol=1e-3)


def test_an_interrupted_run_goes_on(matcap, material, tmp_path, monkeypatch):
    arguments = ["synth", material, "--size", f"{3 * BLOCK}x40", "-j", "1", "-q"]
    assert matcap(*arguments, "-o", "whole").code == 0
    from matcap.synth import stream

    count = stream._Clock.count

    def interrupt(self, written):
        count(self, written)
        raise KeyboardInterrupt

    monkeypatch.setattr(stream._Clock, "count", interrupt)
    said = matcap(*arguments, "-o", "cut")
    assert said.code == 130 and "--resume" in said.err
    assert [file.name for file in (tmp_path / "cut").iterdir()] == [".leather.matcap-part"]
    monkeypatch.setattr(stream._Clock, "count", count)
    said = matcap(*arguments, "--seed", "1", "-o", "cut", "--resume")
    assert said.code == 3 and "other settings" in said.err
    assert matcap(*arguments, "-o", "cut", "--resume").code == 0
    for file in (tmp_path / "whole").iterdir():
        assert filecmp.cmp(file, tmp_path / "cut" / file.name, shallow=False)
    assert len(list((tmp_path / "cut").iterdir())) == 7


def test_a_failed_synth_leaves_no_file(matcap, material, tmp_path):
    half = tmp_path / "half.matcap"
    half.write_bytes(material.read_bytes()[: material.stat().st_size // 2])
    for arguments, said, code in [
        (["none.matcap", "-o", "set"], "none.matcap: there is no such file", 3),
        ([material, "-o", "set", "--size", "100000000x10000"], "are needed but the disk has", 3),
        ([material, "-o", "set", "--size", "99999999999x5"], "more than an OpenEXR file holds", 2),
        ([material, "-o", "set", "--tile", "--size", "100"], "give 96 or 112", 2),
        ([material, "-o", "set", "--udim", "11x1"], "at most 10 columns", 2),
        ([material, "-o", "set", "--maps", "bmp"], "--maps: there is no choice 'bmp'", 2),
        ([material, "-o", "set", "--tile", "xy"], "--tile: there is no 'xy'; ", 2),
        (
            [material, "-o", "set", "--like", "photo.jpg"],
            "--like: this applies only to a material",
            2,
        ),
        ([material, "-o", "set", "-t", "0.2"], "-t: this applies only to a material", 2),
        (["-o", "set", "--like", "none.jpg"], "none.jpg: there is no such file", 3),
        ([material, "-o", material / "set"], "a file stands where a folder is needed", 3),
        (["half.matcap", "-o", "set"], "half.matcap: ", 3),
        ([tmp_path, "-o", "set"], f"{tmp_path}: ", 3),
    ]:
        found = matcap("synth", *arguments)
        assert (found.code, found.err.count("\n")) == (code, 1) and said in found.err
    said = matcap("synth", material, "-o", "set", "--seed", 2**63)
    assert said.code == 2 and "--seed" in said.err
    for size in ("0x5", "-4x5", "5x0", "nonsense"):
        assert matcap("synth", material, "-o", "set", "--size", size).code == 2
    assert sorted(tmp_path.iterdir()) == [half, material]


def test_cuda_without_a_device_is_a_usage_error(matcap, material, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    said = matcap("synth", material, "--size", "8x8", "--device", "cuda")
    assert said.code == 2 and "--device: PyTorch sees no CUDA device; use cpu" in said.err
    assert matcap("synth", material, "--size", "8x8", "--device", "auto", "-o", "set").code == 0


def test_default_folder_names_state_what_differs(matcap, material, tmp_path):
    for asked in (
        ("--region", "-8,4,32,16"), ("--size", "32x16", "--tile"), ("--size", "32x16", "--png"),
        ("--size", "32x16", "--generator", "decoder"),
    ):  # fmt: skip
        assert matcap("synth", material, *asked, "-q").code == 0
    names = {file.name for file in tmp_path.iterdir() if file.is_dir()}
    assert names == {
        f"leather_32x16_seed0_{part}" for part in ("x-8_y4", "tile-both", "png", "decoder")
    }


def test_a_region_and_a_size_exclude_each_other(matcap, material):
    said = matcap("synth", material, "--size", 16, "--region", "0,0,8,8")
    assert said.code == 2 and "--region: a rectangle already has a size" in said.err


def test_a_new_run_mentions_resume(matcap, material, tmp_path):
    part = tmp_path / "set" / ".leather.matcap-part"
    part.mkdir(parents=True)
    (part / "leather_height.exr").write_bytes(bytes(2_000_000))
    said = matcap("synth", material, "--size", "32x16", "-o", "set")
    assert said.code == 0 and "left 2.0 MB of partial files" in said.err and "--resume" in said.err


# `matcap relight`: from a material, a map set or the folder one stands in, to a picture.


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with a map set of 32 x 24 flat, matt, mid-grey texels."""
    import torch

    stack = torch.zeros(6, 24, 32)
    stack[:3], stack[4] = 0.18, 1.0
    write_mapset(MapSet.from_stacked(stack, 2.0 / 32), tmp_path / "set", MapSetInfo("grey"))
    monkeypatch.chdir(tmp_path / "set")
    return tmp_path / "set"


def test_relight_without_arguments_relights_the_current_folder(matcap, folder):
    said = matcap("relight")
    assert (said.code, said.out) == (0, "") and "relit.png" in said.err
    picture = cv2.imread(str(folder / "relit.png"), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (24, 32, 3)
    # Mid-grey in a light that shows white as white is about 118 of 255.
    assert 105 < np.median(picture) < 131


def test_exr_holds_linear_radiance_of_placed_lights(matcap, folder):
    for light, name in [("0,0,2,4", "near.exr"), ("0,0,2,8", "bright.exr"), ("left", "left.exr")]:
        assert matcap("relight", folder / "grey.json", "--light", light, "-o", name, "-q").code == 0
    near, bright = read_exr(folder / "near.exr").pixels, read_exr(folder / "bright.exr").pixels
    assert near.shape == (24, 32, 3) and np.allclose(bright, 2 * near, rtol=1e-5)
    # The middle: albedo / pi * intensity / distance^2.
    assert near[12, 16, 0] == pytest.approx(0.18 / np.pi * 4 / 4, rel=0.01)
    left = read_exr(folder / "left.exr").pixels[12, :, 0]
    assert left[2] > 1.5 * left[-3]


def test_messages_of_libraries_do_not_reach_the_user(matcap, tmp_path):
    (tmp_path / "broken.matcap").write_bytes(b"not safetensors at all")
    said = matcap("synth", tmp_path / "broken.matcap", "-o", tmp_path / "out")
    assert said.code == 3 and "this is not a material, or it is damaged" in said.err
    assert "header" not in said.err and "deserializing" not in said.err
