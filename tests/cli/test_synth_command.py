"""`matcap synth`: any rectangle, as a map set; the field itself is a fake."""

from types import SimpleNamespace

import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap.export.mapset import read_mapset


@pytest.fixture
def material(tmp_path, monkeypatch):
    """A material whose specular map holds x / 1000 and whose roughness holds the seed / 1000."""

    class Field:
        def __init__(self, material, seed=0, period=None):
            self.seed = seed

        def read(self, x, y, width, height):
            stack = torch.zeros(6, height, width)
            stack[3] = (x + torch.arange(width)) / 1000
            stack[4] = self.seed / 1000
            return MapSet.from_stacked(stack, 2.0 / 512)

    def load(path):
        if not path.exists():
            raise MatcapError("no such file", where=str(path), remedy="check the path")
        return SimpleNamespace(name="leather", provenance={"made": "up"})

    monkeypatch.setattr("matcap.synth.field.Field", Field)
    monkeypatch.setattr("matcap.model.material.Material.load", load)
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "leather.matcap"
    path.touch()
    return path


def test_a_rectangle_of_the_field(matcap, material, tmp_path):
    said = matcap("synth", material, "--region", "100,-50,24,8", "--seed", 7, "-o", "set")
    assert (said.code, said.out) == (0, "")
    maps, document = read_mapset(tmp_path / "set")
    assert maps.size == (24, 8)
    assert (document["x"], document["y"], document["seed"]) == (100, -50, 7)
    assert document["provenance"] == {"made": "up"}
    assert maps.specular[0, 0].tolist() == pytest.approx(
        [(100 + i) / 1000 for i in range(24)], 1e-3
    )
    assert maps.roughness.unique().item() == pytest.approx(0.007, 1e-3)


def test_the_default_folder_is_named_after_the_request(matcap, material, tmp_path):
    assert matcap("synth", material, "--size", "40x8", "--seed", 3, "-q").err == ""
    assert read_mapset(tmp_path / "leather_40x8_seed3")[0].size == (40, 8)


def test_twice_the_same_gives_the_same_files(matcap, material, tmp_path):
    for folder in ("a", "b"):
        assert matcap("synth", material, "--size", "16", "--png", "-o", folder).code == 0
    files = sorted(f.name for f in (tmp_path / "a").iterdir())
    assert len(files) == 11
    for name in files:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_failures_leave_nothing(matcap, material, tmp_path):
    for arguments, said in [
        (["none.matcap", "-o", "set"], "none.matcap: no such file; check the path."),
        ([material, "-o", "set", "--size", "100000000x10000"], "are needed but the disk has"),
        ([material, "-o", material / "set"], "a file stands where a folder is needed"),
    ]:
        found = matcap("synth", *arguments)
        assert found.code == 3
        assert said in found.err
        assert found.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == [material]
