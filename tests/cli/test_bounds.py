"""Every number of the command line is finite and in range before any work; counts are bounded."""

import time

import pytest
from materials import a_material

from matcap.files import values


@pytest.fixture
def place(tmp_path, monkeypatch):
    """The current folder, with a folder of one material."""
    (tmp_path / "a").mkdir()
    a_material("a").save(tmp_path / "a" / "a.matcap")
    monkeypatch.chdir(tmp_path)
    return tmp_path


HUGE = "9" * 23


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("blend", "a/a.matcap", "a/a.matcap", "-t", "0:1:99999999"), "more than 256 steps"),
        (("blend", "a/a.matcap", "a/a.matcap", "-t", f"0:1:{HUGE}"), "neither a share"),
        (("blend", "a/a.matcap", "a/a.matcap", "--seed", HUGE), "is out of range"),
        (("synth", "a", "--seed", HUGE), "is out of range"),
        (("synth", "a", "--seed", "1e3"), "is not a whole number"),
        (("relight", "a", "--seed", HUGE), "is out of range"),
        (("view", "a", "--seed", HUGE), "is out of range"),
        (("sample", "--seed", HUGE), "is out of range"),
        (("sample", "--seed", str(2**63 - 1), "-n", "2"), "is out of range"),
        (("export", "a", "--to", "usd", "--seed", HUGE), "is out of range"),
        (("relight", "a", "--light", "1e300,0,1"), "is out of range"),
        (("relight", "a", "--light", "0,0,1e-300"), "is out of range"),
        (("relight", "a", "--light", "0,0,1,1e300"), "is out of range"),
        (("relight", "a", "--light", "nan,0,1"), "is not a light"),
        (("relight", "a", "--tolerance", "inf"), "is not from 0 to 1"),
        (("relight", "a", "--tolerance", "nan"), "is not from 0 to 1"),
        (("relight", "a", "--tolerance", "-1"), "is not from 0 to 1"),
        (("relight", "a", "--size", "99999999"), "a side of more than 32768"),
        (("relight", "a", "--sheet", "100000x100000"), "a side of more than 64"),
        (
            ("relight", "a", "--animate", "turntable", "--frames", "99999999", "-o", "a.gif"),
            "10000",
        ),
        (("relight", "a", "--size", "32768", "--sheet", "64x64"), "GB"),
        (("export", "a", "--to", "usd", "--size", "65536"), "GB"),
        (("synth", "a", "--size", "1000000000", "-j", "1"), "are needed but the disk has"),
        (("synth", "a", "--scheduler", "nonsense"), "'nonsense' is not an address"),
        (("sample", "-t", "nan"), "is not from 0 to 1"),
        (("view", "a", "--html", "a.html", "--tile", "99999999"), "2048"),
        (("inspect", "a", "--fov", "nan"), "is not from 1 to 170"),
        (("inspect", "a.matcap", "--together"), "--together: there are no photographs"),
        (("capture", "a.jpg", "--together"), "--together: there is one photograph"),
        (
            ("capture", "a.jpg", "--no-drawing"),
            "--no-drawing: only a decoder has a drawing among its inputs",
        ),
    ],
)
def test_numbers_out_of_range_are_refused_before_any_work(matcap, place, words, said):
    before, began = sorted(place.rglob("*")), time.monotonic()
    found = matcap(*words)
    assert found.code in (2, 3) and said in " ".join(found.err.replace("│", " ").split())
    assert sorted(place.rglob("*")) == before
    assert time.monotonic() - began < 20.0


def test_options_are_looked_at_before_a_folder_that_is_there(matcap, place):
    assert matcap("synth", "a", "--size", "16", "-j", "1", "-o", "more", "-q").code == 0
    for wrong in (
        ("--scheduler", "nonsense"), ("--adjust", "relief=x"), ("--udim", "11x1"),
        ("--tile", "x", "--region", "0,0,17,16"), ("--mask", "none.png"), ("--export", "unrael"),
    ):  # fmt: skip
        said = matcap("synth", "a", "--seed", "2", "-o", "more", "-j", "1", *wrong)
        assert said.code == 2 and "exists" not in said.err, wrong


def test_synth_takes_the_folder_that_others_take(matcap, place):
    words = ("--size", "16", "-j", "1", "-q")
    assert matcap("synth", "a", *words).code == 0
    assert (place / "a_16x16_seed0" / "a.json").is_file()
    (place / "empty").mkdir()
    said = matcap("synth", "empty", *words)
    assert said.code == 3 and "no map set and no material in this folder" in said.err
    said = matcap("synth", "a_16x16_seed0", *words)
    assert said.code == 3 and "this is a map set, from which no more can be synthesised" in said.err


def test_several_lights_add_up(matcap, place):
    import numpy as np

    from matcap.files.exr import read_exr

    for name, lights in {"both": ("left", "top"), "left": ("left",), "top": ("top",)}.items():
        words = [word for light in lights for word in ("--light", light)]
        said = matcap(
            "relight", "a", *words, "--effects", "all", "--size", "32", "-o", f"{name}.exr"
        )
        assert said.code == 0, said.err
    both, left, top = (read_exr(place / f"{name}.exr").pixels for name in ("both", "left", "top"))
    off = np.abs(both - left - top).mean()  # each light by itself has parallax and shadows
    assert off < 0.02 * both.mean()


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "1e400", "x", ""])
def test_no_number_is_none(text):
    with pytest.raises(ValueError, match="is not"):
        values.number(0.0, 1.0)(text)


@pytest.mark.parametrize("seed", [-(2**63), 2**63 - 1, 0])
def test_seeds_of_64_bits_are_seeds(seed):
    assert values.seed(str(seed)) == seed
