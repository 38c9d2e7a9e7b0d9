"""`matcap relight`: from a material, a map set or the folder one stands in, to a picture."""

import cv2
import numpy as np
import pytest

from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.brdf.maps import MapSet
from matcap.files.exr import read_exr


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with a map set of 32 x 24 flat, matt, mid-grey texels."""
    import torch

    stack = torch.zeros(6, 24, 32)
    stack[:3], stack[4] = 0.18, 1.0
    write_mapset(MapSet.from_stacked(stack, 2.0 / 32), tmp_path / "set", MapSetInfo("grey"))
    monkeypatch.chdir(tmp_path / "set")
    return tmp_path / "set"


def test_the_current_folder_under_the_default_light(matcap, folder):
    said = matcap("relight")
    assert (said.code, said.out) == (0, "")
    assert "relit.png" in said.err
    picture = cv2.imread(str(folder / "relit.png"), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (24, 32, 3)
    # Mid-grey in a light that shows white as white is about 118 of 255.
    assert 105 < np.median(picture) < 131


def test_linear_radiance_by_suffix_and_lights_by_place(matcap, folder):
    for light, name in [("0,0,2,4", "near.exr"), ("0,0,2,8", "bright.exr"), ("left", "left.exr")]:
        assert matcap("relight", folder / "grey.json", "--light", light, "-o", name, "-q").code == 0
    near, bright = read_exr(folder / "near.exr").pixels, read_exr(folder / "bright.exr").pixels
    assert near.shape == (24, 32, 3)
    assert np.allclose(bright, 2 * near, rtol=1e-5)
    # The middle: albedo / pi * intensity / distance^2.
    assert near[12, 16, 0] == pytest.approx(0.18 / np.pi * 4 / 4, rel=0.01)
    left = read_exr(folder / "left.exr").pixels[12, :, 0]
    assert left[2] > 1.5 * left[-3]


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--light", "below"], 2, "is not a light"),
        (["--light", "0,0,-1"], 2, "not above the plane"),
        (["-o", "a.gif"], 2, "unknown picture format"),
        (["none"], 3, "no such file or folder"),
        (["-o", "grey.json/a.png"], 3, "a file stands where a folder is needed"),
    ],
)
def test_failures_are_sentences_and_leave_nothing(matcap, folder, arguments, code, said):
    before = sorted(folder.iterdir())
    found = matcap("relight", *arguments)
    assert found.code == code
    assert said in found.err
    assert found.err.count("\n") == 1
    assert sorted(folder.iterdir()) == before
