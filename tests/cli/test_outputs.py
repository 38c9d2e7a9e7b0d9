"""Commands replace files with --overwrite alone, and never what they read."""

import json
import shutil

import cv2
import numpy as np
import pytest
from materials import a_material
from random_maps import random_maps

from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.export.targets import TARGETS

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


def everything(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


WRITERS = {
    "relight": (("relight", "set", "--size", "32"), "relit.png"),
    "sample": (("sample", "-n", "1"), "sampled.png"),
    "view": (("view", "set"), "index.html"),
    "blend": (("blend", "a.matcap", "b.matcap", "-t", "0.5"), "a_b_0.500.matcap"),
    "synth": (("synth", "a.matcap", "--size", "16", "-j", "1"), "a_height.exr"),
    # A target with documents of its own in both workflows, a preset, and one with a script.
    **{to: (("export", "set", "--to", to), None) for to in ("usd", "polyhaven", "unreal")},
}  # fmt: skip


@pytest.mark.parametrize("writer", WRITERS)
def test_existing_files_are_replaced_with_overwrite_alone(matcap, place, writer):
    words, file = WRITERS[writer]
    if file is None:
        assert matcap(*words, "-o", "first", "-q").code == 0
        file = min(one.name for one in (place / "first").iterdir() if one.suffix != ".json")
    out = place / "out"
    out.mkdir()
    (out / file).write_bytes(MINE)
    target = {"relight": out / file, "sample": out / file}
    option = "--html" if writer == "view" else "-o"
    words = (*words, option, out / file if writer == "view" else target.get(writer, out), "-q")
    said = matcap(*words)
    advice = f"this exists already; choose another name with {option}, or give --overwrite"
    assert said.code == 3 and advice in said.err
    assert everything(out) == {file: MINE} and matcap(*words, "--overwrite").code == 0
    assert (out / file).read_bytes() != MINE


def test_a_picture_in_the_folder_of_its_maps_is_replaced(matcap, place):
    for _ in range(2):
        words = ("relight", "set", "--size", "32", "-o", "set/relit.exr", "--overwrite")
        assert matcap(*words, "-q").code == 0


@pytest.mark.parametrize(
    "words",
    [
        ("relight", "set", "-o", "set/moss_diffuse.exr"),
        ("relight", "set/moss.json", "-o", "set/moss_height.exr"),
        ("relight", "--maps-from", "maps", "-o", "maps/a_diffuse.exr"),
        ("export", "set", "--to", "raw", "-o", "set"),
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
    assert found.code == 2 and said in found.err and everything(place) == before


def test_a_page_that_cannot_be_written_is_not_made(matcap, place, monkeypatch):
    monkeypatch.setattr("matcap.view.document.sealed_page", None)
    (place / "taken").write_text("a file")
    said = matcap("view", "set", "--html", "taken/page.html")
    assert said.code == 3 and "a file stands where a folder is needed" in said.err


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
