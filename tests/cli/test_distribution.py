"""Wheel and sdist: what is in them, and that the wheel works away from the source tree."""

import os
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
DATA = ("matcap/py.typed", "matcap/space/prior/weights/prior.safetensors")

BUILD = """
import sys
from setuptools import build_meta
out = sys.argv[1]  # building changes the arguments
build_meta.build_wheel(out)
build_meta.build_sdist(out)
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


@pytest.fixture(scope="module")
def dist(tmp_path_factory) -> Path:
    """A folder with wheel and sdist, built offline from a copy of the sources."""
    setuptools = pytest.importorskip("setuptools")
    if int(setuptools.__version__.split(".")[0]) < 77:
        pytest.skip("building needs setuptools 77 or later")
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    for file in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / file, source)
    ignore = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "matcap", source / "matcap", ignore=ignore)
    command = [sys.executable, "-c", BUILD, str(out)]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return out


def packaged() -> set[str]:
    """All files of the package, as they lie in the tree."""
    files = (path for path in (ROOT / "matcap").rglob("*") if path.is_file())
    return {str(f.relative_to(ROOT)) for f in files if "__pycache__" not in f.parts}


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
    (wheel,) = dist.glob("*.whl")
    site, work = tmp_path / "site", tmp_path / "work"
    work.mkdir()
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    command = [sys.executable, "-c", USE, str(site)]
    place = os.environ | {"PYTHONPATH": str(site), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=work, env=place, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (work / "scene" / "matcap_bsdf.py").is_file()
    assert list((work / "script").glob("*_blender.py"))
