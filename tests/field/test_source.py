"""Opening whatever a user points at."""

from types import SimpleNamespace

import pytest
import torch

from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.errors import MatcapError, UsageError
from matcap.field.opened import open_tile
from matcap.field.options import ReadOptions


@pytest.fixture
def material(monkeypatch, maps):
    """Material.load gives something whose maps are known; it takes any file."""
    asked = []

    def load(path):
        def read(width, height, *, seed, period):
            asked.append((path.name, width, height, seed, period))
            return maps

        found = SimpleNamespace(maps=read, alignment=16, provenance={})
        found.by = lambda generator: found
        found.varied = lambda variety: found
        return found

    monkeypatch.setattr("matcap.field.material.Material.load", load)
    return asked


def test_a_material_file_is_read_at_the_size_and_seed_asked_for(tmp_path, material, maps):
    (tmp_path / "a.MATCAP").touch()
    for size, period in (((40, 30), None), ((48, 32), (48, 32))):
        assert open_tile(tmp_path / "a.MATCAP", size=size, seed=5).maps is maps
        assert material.pop() == ("a.MATCAP", *size, 5, period)


def test_a_folder_with_a_material_only(tmp_path, material, maps):
    (tmp_path / "a.matcap").touch()
    (tmp_path / "report.json").write_text("{}")
    assert open_tile(tmp_path).maps is maps


def test_a_folder_means_its_material_and_a_map_sets_file_that_map_set(tmp_path, material, maps):
    write_mapset(maps, tmp_path, MapSetInfo("a"))
    assert torch.equal(open_tile(tmp_path).maps.height, maps.height)
    assert material == []
    (tmp_path / "a.matcap").touch()
    assert open_tile(tmp_path).maps is maps
    assert len(material) == 1
    assert torch.equal(open_tile(tmp_path / "a.json").maps.height, maps.height)
    assert len(material) == 1


def test_a_size_or_seed_asked_of_a_map_set_is_refused_by_name(tmp_path, maps):
    write_mapset(maps, tmp_path, MapSetInfo("a"))
    assert open_tile(tmp_path).name == "a"
    asked = {"size": {"size": (64, 64)}, "seed": {"seed": 0}}
    for option, value in (asked | {"generator": {"read": ReadOptions("decoder")}}).items():
        with pytest.raises(UsageError, match=f"--{option}: this is a map set"):
            open_tile(tmp_path, **value)


def test_nothing_or_too_much_to_open(tmp_path, material):
    with pytest.raises(MatcapError, match="no map set and no material"):
        open_tile(tmp_path)
    with pytest.raises(MatcapError, match="no such file or folder"):
        open_tile(tmp_path / "none")
    for name in ("a.matcap", "b.matcap"):
        (tmp_path / name).touch()
    with pytest.raises(MatcapError, match=r"2 materials in this folder \(a.matcap, b.matcap\)"):
        open_tile(tmp_path)
