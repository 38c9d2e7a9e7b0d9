"""What docs/notes/verdict.md says that `inspect` sees of photographs that break a capture."""

import importlib.util
from pathlib import Path

import pytest

from matcap.lab.simulate.photograph import PhoneCamera
from matcap.lab.simulate.write_jpeg import write_jpeg
from matcap.photo.inspect import inspect_photo
from matcap.photo.load import load_photo

SCRIPT = Path(__file__).parents[2] / "docs" / "images" / "failing.py"
SEEN = {"painting": "stationarity", "no-flash": "flash", "lamp": "hot_spot"}
UNSEEN = ("check", "knot", "polished")


@pytest.fixture(scope="module")
def failing():
    """The script's photographs, by a camera of fewer pixels."""
    spec = importlib.util.spec_from_file_location("failing", SCRIPT)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    script.CAMERA = PhoneCamera(width=640, height=480, supersampling=1)
    return script


def inspected(failing, name, folder):
    file = folder / f"{name}.jpg"
    write_jpeg(file, failing.SHOTS[name](), 1)
    return inspect_photo(load_photo(file))


@pytest.mark.parametrize("name", SEEN)
def test_what_is_seen_before_is_told_apart(failing, name, tmp_path):
    found = inspected(failing, name, tmp_path)
    worst = {f.name for f in found.findings if not f.rating.fit}
    assert worst == {SEEN[name]}


@pytest.mark.parametrize("name", UNSEEN)
def test_what_is_not_seen_before_is_not_refused(failing, name, tmp_path):
    """A limit: no period is looked for, nothing that is there once, and no spike."""
    found = inspected(failing, name, tmp_path)
    assert found.rating.fit
