"""An output replaces what the same command wrote, or with --overwrite; never what it reads."""

import json
import shutil

import cv2
import numpy as np
import pytest
from materials import a_material
from random_maps import random_maps

from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.export.targets import TARGETS
from matcap.files.mark import mark_of

MINE = b"what somebody made"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder: two materials, a map set called moss, a picture and a text of somebody's."""
    folder = tmp_path_factory.mktemp("made")
    write_mapset(random_maps(32, 32, low=0.2, high=0.7), folder / "set", MapSetInfo("moss"))
    for name in ("a", "b"):
        a_material(name, across=256).save(folder / f"{name}.matcap")
    cv2.imwrite(str(folder / "photo.png"), np.full((48, 64, 3), 128, np.uint8))
    (folder / "notes.png").write_bytes(MINE)
    return folder


@pytest.fixture
def place(made, tmp_path, monkeypatch):
    """A copy of it, in which commands run."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


PICTURES = {
    "relight": ("relight", "set", "--size", "32", "-q"),
    "sample": ("sample", "-n", "1", "-q"),
}


def everything(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.mark.parametrize("command", ["relight", "sample"])
def test_a_foreign_picture_is_replaced_only_with_overwrite(matcap, place, command):
    for other in ("photo.png", "notes.png"):
        before = everything(place)
        said = matcap(*PICTURES[command], "-o", other)
        assert said.code == 3 and f"which matcap {command} has not written" in said.err
        assert everything(place) == before
        assert matcap(*PICTURES[command], "-o", other, "--overwrite").code == 0
        assert mark_of(place / other) == f"matcap {command}"
        assert matcap(*PICTURES[command], "-o", other).code == 0


def test_a_command_does_not_replace_the_picture_of_another(matcap, place):
    assert matcap(*PICTURES["relight"], "-o", "drawn.png").code == 0
    assert matcap(*PICTURES["relight"], "-o", "drawn.png").code == 0
    said = matcap(*PICTURES["sample"], "-o", "drawn.png")
    assert said.code == 3 and "which matcap sample has not written" in said.err


@pytest.mark.parametrize("suffix", ["png", "exr", "gif", "mp4", "frames.exr"])
def test_every_format_names_the_command_that_wrote_it(matcap, place, suffix):
    moving = ("--animate", "light-orbit", "--frames", "2") * (suffix not in ("png", "exr"))
    for _ in range(2):
        assert matcap(*PICTURES["relight"], *moving, "-o", f"made.{suffix}").code == 0
    file = "made.frames_0001.exr" if "frames" in suffix else f"made.{suffix}"
    assert mark_of(place / file) == "matcap relight"


@pytest.mark.parametrize(
    "words",
    [
        ("relight", "set", "-o", "set/moss_diffuse.exr"),
        ("relight", "set/moss.json", "-o", "set/moss_height.exr"),
        ("relight", "--maps-from", "maps", "-o", "maps/a_diffuse.exr"),
        ("export", "set", "--to", "raw", "--maps", "diffuse", "-o", "set"),
    ],
)
def test_no_command_writes_over_what_it_reads(matcap, place, words):
    shutil.copytree(place / "set", place / "maps")
    (place / "maps" / "moss_diffuse.exr").rename(place / "maps" / "a_diffuse.exr")
    before = everything(place)
    said = matcap(*words, "--overwrite")
    assert said.code == 2 and "the same command reads this file" in said.err
    assert everything(place) == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("relight", "set", "-o", "a.matcap"), "unknown picture format"),
        (("sample", "-o", "a.matcap"), "unknown picture format"),
        (("view", "set", "--html", "a.matcap"), "unknown page format"),
    ],
)
def test_suffixes_are_checked_everywhere(matcap, place, words, said):
    before = everything(place)
    found = matcap(*words, "--overwrite")
    assert found.code == 2 and said in found.err
    assert everything(place) == before


def test_view_replaces_only_its_own_pages(matcap, place):
    (place / "index.html").write_bytes(MINE)
    words = ("view", "set", "--html", "index.html", "-q")
    said = matcap(*words)
    assert said.code == 3 and "which matcap view has not written" in said.err
    assert (place / "index.html").read_bytes() == MINE
    assert matcap(*words, "--overwrite").code == matcap(*words).code == 0


def test_blend_replaces_only_blends(matcap, place):
    words = ("blend", "a.matcap", "b.matcap", "-t", "0.5", "-o", ".", "-q")
    assert matcap(*words).code == matcap(*words).code == 0
    shutil.copy(place / "a.matcap", place / "a_b_0.500.matcap")
    said = matcap(*words)
    assert said.code == 3 and "which matcap blend has not written" in said.err


@pytest.mark.parametrize("target", TARGETS)
def test_an_export_replaces_no_foreign_file(matcap, place, target):
    words = ("export", "set", "--to", target, "-o", "out", "-q")
    assert matcap(*words).code == 0
    files = [file for file in (place / "out").iterdir() if file.suffix != ".json"]
    shutil.rmtree(place / "out")
    (place / "out").mkdir()
    files[0].write_bytes(MINE)
    said = matcap(*words)
    assert said.code == 3 and "which matcap export has not written" in said.err
    assert [file.read_bytes() for file in (place / "out").iterdir()] == [MINE]
    if target == "raw":
        assert matcap(*words, "--overwrite").code == 0
        assert files[0].read_bytes() != MINE


def test_a_map_set_replaces_no_foreign_file(matcap, place):
    (place / "more").mkdir()
    (place / "more" / "a_height.exr").write_bytes(MINE)
    words = ("synth", "a.matcap", "--size", "16", "-j", "1", "-o", "more", "-q")
    said = matcap(*words)
    assert said.code == 3 and "a file of this name exists, and belongs to no map set" in said.err
    assert (place / "more" / "a_height.exr").read_bytes() == MINE
    assert matcap(*words, "--overwrite").code == matcap(*words).code == 0


def test_a_mask_is_not_replaced_by_the_map_set_made_with_it(matcap, place):
    (place / "a_diffuse.png").write_bytes((place / "photo.png").read_bytes())
    said = matcap(
        "synth", "a.matcap", "--size", "16", "-j", "1", "--png", "--blend", "b.matcap",
        "--mask", "a_diffuse.png", "-o", ".", "--overwrite",
    )  # fmt: skip
    assert said.code == 2 and "the same command reads this file" in said.err


FORGED = ("../../victim/keep", "../x", "/tmp/x", ".keep", "a\nb", "a\0b")


@pytest.mark.parametrize(
    ("target", "name"),
    [*((one, FORGED[0]) for one in TARGETS), *(("raw", one) for one in FORGED[1:])],
)
def test_a_forged_name_is_refused_by_every_exporter(matcap, place, target, name):
    """Of the issue: `"name": "../../victim/keep"` wrote over a foreign keep.glb, with exit 0."""
    file = place / "set" / "moss.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"name": name}))
    before = everything(place)
    said = matcap("export", "set", "--to", target, "-o", "out/deep", "--overwrite")
    assert said.code == 3 and "the map set's description is damaged: 'name' is" in said.err
    assert everything(place) == before and not (place / "out").exists()
