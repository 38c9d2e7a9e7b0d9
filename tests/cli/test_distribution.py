"""Wheel and sdist: what is in them, and that the wheel works away from the source tree.

The laboratory is a distribution of its own, in lab/.
"""

import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# What git tracks in the package and setuptools would leave out unless told.
DATA = (
    "matcap/py.typed",
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
    """A copy of the sources."""
    setuptools = pytest.importorskip("setuptools")
    if int(setuptools.__version__.split(".")[0]) < 77:
        pytest.skip("building needs setuptools 77 or later")
    source = tmp_path_factory.mktemp("source")
    for file in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / file, source)
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
    return subprocess.run(
        [sys.executable, "-c", NO_EDITABLE + script, str(site)],
        cwd=work,
        env=os.environ | {"PYTHONPATH": str(site), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_wheel_has_the_whole_package_and_nothing_else(dist):
    (wheel,) = dist.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
        about = next(name for name in archive.namelist() if name.endswith("/METADATA"))
        metadata = archive.read(about).decode()
        licences = [name for name in archive.namelist() if name.endswith("licenses/LICENSE")]
    assert names == packaged()
    assert set(DATA) <= names
    assert "License-Expression: Apache-2.0" in metadata
    assert licences


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
