"""The distribution: what is installed, its public names and its self-test."""

import importlib
import inspect
import json
import os
import pickle
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import SimpleNamespace

import pytest

import matcap
from matcap.errors import MatcapError, UsageError
from matcap.space.prior import store

# Wheel and sdist: what is in them, and that the wheel works away from the source tree.
#
# The laboratory is a distribution of its own, in lab/.

ROOT = Path(__file__).parents[2]
# What git tracks in the package and setuptools would leave out unless told.
DATA = (
    "matcap/py.typed",
    "matcap/flash/weights/alignment.safetensors",
    "matcap/space/prior/weights/prior.safetensors",
    "matcap/capture/exemplar/network/weights/inverse.safetensors",
    "matcap/view/page/view.js",
)

BUILD = """
import sys
from setuptools import build_meta
out = sys.argv[1]  # building changes the arguments
build_meta.build_wheel(out)
build_meta.build_sdist(out)
"""

# An editable install would stand in for what the wheels lack.
NO_EDITABLE = """
import sys
for finder in list(sys.meta_path):
    if finder.__module__.startswith("__editable__"):
        sys.meta_path.remove(finder)
"""
USE = """
import sys
from pathlib import Path
import matcap
assert Path(matcap.__file__).is_relative_to(sys.argv[1]), matcap.__file__
from matcap.cli.main import main
for words in (
    ["synth", "--size", "48x32", "-o", "set", "-q"],
    ["export", "set", "--to", "mitsuba", "-o", "scene", "-q"],
    ["export", "set", "--to", "blender", "-o", "script", "-q"],
):
    code = main(words)
    assert code == 0, (words, code)
"""


def build(script: str, source: Path, out: Path) -> None:
    """Build offline, where setuptools can."""
    command = [sys.executable, "-c", script, str(out)]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    """A copy of the sources, whose loops compile in a fifth of the time; they hardly run here."""
    setuptools = pytest.importorskip("setuptools")
    if int(setuptools.__version__.split(".")[0]) < 77:
        pytest.skip("building needs setuptools 77 or later")
    source = tmp_path_factory.mktemp("source")
    for file in ("README.md", "LICENSE"):
        shutil.copy(ROOT / file, source)
    project = (ROOT / "pyproject.toml").read_text("utf-8")
    (source / "pyproject.toml").write_text(project.replace('"-O3"', '"-O0"'), "utf-8")
    ignore = shutil.ignore_patterns("__pycache__", "build", "*.egg-info")
    shutil.copytree(ROOT / "matcap", source / "matcap", ignore=ignore)
    return source


@pytest.fixture(scope="module")
def dist(source, tmp_path_factory) -> Path:
    """A folder with wheel and sdist."""
    out = tmp_path_factory.mktemp("dist")
    build(BUILD, source, out)
    return out


def packaged() -> set[str]:
    """All files of the package, as they lie in the tree."""
    files = (path for path in (ROOT / "matcap").rglob("*") if path.is_file())
    return {str(f.relative_to(ROOT)) for f in files if "__pycache__" not in f.parts}


def unpacked(site: Path, *wheels: Path) -> Path:
    """Wheels as pip lays them out, in one folder."""
    for wheel in wheels:
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(site)
    return site


def python(script: str, site: Path, work: Path) -> subprocess.CompletedProcess[str]:
    """Run a script in a folder, with what is unpacked in another."""
    work.mkdir()
    command = [sys.executable, "-c", NO_EDITABLE + script, str(site)]
    place = os.environ | {"PYTHONPATH": str(site), "OMP_NUM_THREADS": "1"}
    return subprocess.run(command, cwd=work, env=place, capture_output=True, text=True)


def test_the_wheel_has_the_whole_package_and_nothing_else(dist):
    (wheel,) = dist.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
        about = next(name for name in archive.namelist() if name.endswith("/METADATA"))
        metadata = archive.read(about).decode()
        licences = [name for name in archive.namelist() if name.endswith("licenses/LICENSE")]
    assert names == packaged() and set(DATA) <= names
    assert "License-Expression: Apache-2.0" in metadata and licences


def test_the_sdist_has_all_that_the_wheel_is_built_from(dist):
    (sdist,) = dist.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    compiled = tuple(EXTENSION_SUFFIXES)  # made of the sources, in place
    sources = {name for name in packaged() if not name.endswith(compiled)}
    assert sources | {"pyproject.toml", "README.md", "LICENSE"} <= names


def test_the_wheel_works_away_from_the_source_tree(dist, tmp_path):
    site, work = unpacked(tmp_path / "site", *dist.glob("*.whl")), tmp_path / "work"
    done = python(USE, site, work)
    assert done.returncode == 0, done.stderr
    assert (work / "scene" / "matcap_bsdf.py").is_file()
    assert list((work / "script").glob("*_blender.py"))


def test_nothing_of_the_product_or_of_its_tests_imports_the_laboratory():
    files = [*(ROOT / "matcap").rglob("*.py"), *(ROOT / "tests").rglob("*.py")]
    imported = re.compile(r"^\s*(from|import) matcap_lab", re.MULTILINE)
    assert [file.name for file in files if imported.search(file.read_text("utf-8"))] == []


# `import matcap`: the names it promises, and no others.

NAMES = {
    "Field", "MapSet", "MapSetInfo", "MatcapError", "Material", "__version__", "capture",
    "load_photo", "read_mapset", "relight", "write_mapset",
}  # fmt: skip


def test_public_names_are_a_promise():
    assert set(matcap.__all__) == NAMES and set(dir(matcap)) == NAMES


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
    assert int(found.stdout) > 150


@pytest.mark.parametrize(("name", "first"), [("capture", "path"), ("relight", "source")])
def test_packages_that_are_called_say_how_and_are_sent_to_processes(name, first):
    package = getattr(matcap, name)
    assert package is importlib.import_module(f"matcap.{name}")
    assert next(iter(inspect.signature(package).parameters)) == first
    assert pickle.loads(pickle.dumps(package)) is package


def test_capture_hands_its_settings_on(pipeline, photo):
    assert matcap.capture(photo, preset="draft", detail=256, fov=50.0).name == "leather"
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

    monkeypatch.setattr("matcap.capture.run.capture_file", captured)
    assert matcap.capture("a.dng", "b.dng", "c.dng", union=True) == "one"
    assert read == ["a.dng", "b.dng", "c.dng", True]


def test_a_union_of_one_photograph_is_refused(photo):
    with pytest.raises(matcap.MatcapError, match="this needs several photographs"):
        matcap.capture(photo, preset="instant", union=True)


# `matcap doctor`: what it finds, and that it finds what is wrong.


def test_a_sound_installation(matcap):
    said = matcap("doctor", "--json")
    report = json.loads(said.out)
    assert report["self_test"]["fault"] is None and report["compiled"]
    assert (said.code, said.err, report["healthy"]) == (0, "", True)
    assert {"torch", "numpy", "typer"} <= set(report["packages"]) and report["devices"][0] == "cpu"


@pytest.fixture
def without(monkeypatch):
    """Make a package one that is not installed."""

    def hide(hidden):
        def found(name):
            if name == hidden:
                raise PackageNotFoundError(name)
            return version(name)

        monkeypatch.setattr("matcap.cli.doctor.version", found)

    return hide


def test_the_text_names_the_command_that_installs_a_missing_extra(matcap, without):
    without("pillow-heif")
    said = matcap("doctor", "--no-self-test")
    assert said.code == 0  # extras are no need
    assert (
        'pillow-heif missing; to install it: pip install "matcap[heic]"' in said.out
        and "All is well." in said.out
    )


def test_a_missing_requirement_is_a_fault(matcap, without):
    without("rawpy")
    said = matcap("doctor")
    assert said.code == 3 and "rawpy" in said.out and "MISSING" in said.out


@pytest.mark.parametrize("fault", [MatcapError("the prior is damaged"), RuntimeError("no memory")])
def test_a_fault_of_the_self_test_is_reported(matcap, monkeypatch, fault):
    def broken(path=None):
        raise fault

    monkeypatch.setattr(store, "load_prior", broken)
    said = matcap("doctor", "--json")
    report = json.loads(said.out)
    assert (said.code, report["healthy"]) == (3, False)
    assert str(fault) in report["self_test"]["fault"]
