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


@pytest.mark.parametrize(
    "imports",
    [
        "import matcap",
        "import matcap.capture.pipeline, matcap.relight.scene",
        "import matcap; import matcap.capture.detail, matcap.relight.scene",
        "import matcap; from matcap.capture import detail; from matcap.relight import scene",
        "from matcap.capture.settings import DETAIL; import matcap.relight; import matcap",
    ],
)
def test_functions_keep_their_names_whatever_is_imported_of_their_packages(imports):
    code = f"{imports}; print(matcap.capture.__module__, matcap.relight.__module__)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout == "matcap.api matcap.api\n"


def test_capture_hands_its_settings_on(pipeline, photo):
    material = matcap.capture(photo, preset="draft", detail=256, fov=50.0)
    assert material.name == "leather"
    (call,) = pipeline.calls
    assert (call.long_side, call.fov, call.settings.preset) == (256, 50.0, "draft")
    with pytest.raises(TypeError, match="speed"):
        matcap.capture(photo, speed="fast")
