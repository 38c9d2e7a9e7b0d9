"""The commands on a real, if random, material, in processes of their own."""

import filecmp
import subprocess
import sys

import pytest
from materials import a_material

from matcap.files.exr import read_exr


def run(folder, *arguments):
    command = [sys.executable, "-c", "from matcap.cli.main import run; run()", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a small material."""
    folder = tmp_path_factory.mktemp("material")
    a_material("noise", across=512).save(folder / "noise.matcap")
    return folder


def test_the_same_request_in_two_processes_gives_the_same_files(folder, matcap):
    words = ("--size", "96x40", "--seed", "7", "--png", "-o")
    assert matcap("synth", folder / "noise.matcap", *words, folder / "first").code == 0
    said = run(folder, "synth", "noise.matcap", *words, "second")
    assert said.returncode == 0, said.stderr
    files = sorted(f.name for f in (folder / "first").iterdir())
    assert len(files) == 12
    for name in files:
        assert filecmp.cmp(folder / "first" / name, folder / "second" / name, shallow=False)


def test_a_command_that_read_pictures_ends_without_a_word_of_leaks(folder, matcap):
    """Python is not to skip at its end what OpenImageIO then would miss."""
    made = matcap("synth", folder / "noise.matcap", "--size", "32x32", "-o", folder / "small")
    assert made.code == 0
    said = run(folder, "relight", "small", "--quiet", "--size", "64x48", "-o", "small.png")
    assert (said.returncode, said.stderr) == (0, "")


def test_a_material_relights_without_a_map_set(matcap, folder):
    material, picture = folder / "noise.matcap", folder / "a.exr"
    assert matcap("relight", material, "--size", "40x30", "-o", picture).code == 0
    assert read_exr(picture).pixels.shape == (30, 40, 3)


def test_a_material_is_for_everybody_whom_other_files_are_for(folder):
    (folder / "other").touch()
    assert (folder / "noise.matcap").stat().st_mode == (folder / "other").stat().st_mode
