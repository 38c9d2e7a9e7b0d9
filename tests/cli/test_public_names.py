"""`import matcap`: the names it promises, and no others."""

import subprocess
import sys

import pytest

import matcap

NAMES = {
    "Field", "MapSet", "MapSetInfo", "MatcapError", "Material", "__version__", "capture",
    "load_photo", "read_mapset", "relight", "write_mapset",
}  # fmt: skip


def test_public_names_are_a_promise():
    assert set(matcap.__all__) == NAMES
    assert set(dir(matcap)) == NAMES


@pytest.mark.parametrize("name", sorted(NAMES - {"__version__"}))
def test_every_name_is_there_and_callable(name):
    assert callable(getattr(matcap, name))


def test_unknown_names_are_attribute_errors():
    with pytest.raises(AttributeError, match="'captrue'"):
        _ = matcap.captrue


@pytest.mark.parametrize("first", ["matcap.capture.pipeline", "matcap.relight.scene", "matcap"])
def test_packages_stay_callable_whatever_was_imported_before(first):
    code = f"import {first}, matcap; print(callable(matcap.capture), callable(matcap.relight))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout == "True True\n"


def test_capture_hands_its_settings_on(pipeline, photo):
    material = matcap.capture(photo, preset="draft", detail=256, fov=50.0)
    assert material.name == "leather"
    (call,) = pipeline.calls
    assert (call.long_side, call.fov, call.settings.preset) == (256, 50.0, "draft")
    with pytest.raises(TypeError, match="speed"):
        matcap.capture(photo, speed="fast")
