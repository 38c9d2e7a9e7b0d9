"""`import matcap`: the names it promises, and no others."""

import importlib
import inspect
import pickle
import subprocess
import sys
from types import SimpleNamespace

import pytest

import matcap
from matcap.errors import UsageError

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


def test_every_module_is_imported_by_its_name():
    """`import matcap.a.b as c` looks for a in matcap: nothing else may stand in its place."""
    program = """
import pkgutil, sys
import matcap
names = [one.name for one in pkgutil.walk_packages(matcap.__path__, "matcap.")]
for name in names:
    if name.startswith("matcap.export.scripts.") or name.endswith(".kernel"):
        continue  # run by other programs; loaded by ctypes
    try:
        __import__(name)
    except ModuleNotFoundError as missing:
        if missing.name.startswith("matcap"):
            raise
        continue  # an extra
    known = {}
    exec(f"import {name} as it", known)
    assert known["it"] is sys.modules[name], name
print(len(names))
"""
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    assert int(found.stdout) > 300


@pytest.mark.parametrize(("name", "first"), [("capture", "path"), ("relight", "source")])
def test_packages_that_are_called_say_how_and_are_sent_to_processes(name, first):
    package = getattr(matcap, name)
    assert package is importlib.import_module(f"matcap.{name}")
    assert next(iter(inspect.signature(package).parameters)) == first
    assert pickle.loads(pickle.dumps(package)) is package


def test_capture_hands_its_settings_on(pipeline, photo):
    material = matcap.capture(photo, preset="draft", detail=256, fov=50.0)
    assert material.name == "leather"
    (call,) = pipeline.calls
    assert (call.long_side, call.fov, call.settings.preset) == (256, 50.0, "draft")


def test_an_unknown_setting_or_a_wrong_path_is_a_usage_error(photo):
    with pytest.raises(UsageError, match="'stps'; did you mean 'steps'"):
        matcap.capture(photo, stps=3)
    for paths in ([[photo, photo]], [photo, None]):
        with pytest.raises(UsageError, match="separate arguments"):
            matcap.capture(*paths)
    with pytest.raises(UsageError, match="Material.load"):
        matcap.relight("leather.matcap")


def test_several_photographs_of_one_piece_are_read_together(monkeypatch):
    read = []

    def captured(path, settings, others):
        read.extend([path, *others, settings.union])
        return SimpleNamespace(material="one")

    monkeypatch.setattr("matcap.capture.pipeline.capture_file", captured)
    assert matcap.capture("a.dng", "b.dng", "c.dng", union=True) == "one"
    assert read == ["a.dng", "b.dng", "c.dng", True]


def test_a_union_of_one_photograph_is_refused(photo):
    with pytest.raises(matcap.MatcapError, match="this needs several photographs"):
        matcap.capture(photo, preset="instant", union=True)
