"""Opening whatever a user points at."""

from types import SimpleNamespace

import pytest
import torch

from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.errors import MatcapError
from matcap.model.opened import open_maps


@pytest.fixture
def material(monkeypatch, maps):
    """Material.load gives something whose maps are known; it takes any file."""
    asked = []

    def load(path):
        def read(width, height, *, seed, generator):
            asked.append((path.name, width, height, seed, generator))
            return maps

        return SimpleNamespace(maps=read)

    monkeypatch.setattr("matcap.model.material.Material.load", load)
    return asked


def test_a_material_file_is_read_at_the_size_and_seed_asked_for(tmp_path, material, maps):
    (tmp_path / "a.MATCAP").touch()
    asked = {"size": (40, 30), "seed": 5, "generator": "decoder"}
    assert open_maps(tmp_path / "a.MATCAP", **asked) is maps
    assert material == [("a.MATCAP", 40, 30, 5, "decoder")]


def test_a_folder_with_a_material_only(tmp_path, material, maps):
    (tmp_path / "a.matcap").touch()
    (tmp_path / "report.json").write_text("{}")
    assert open_maps(tmp_path) is maps


def test_a_folders_map_set_goes_before_its_material(tmp_path, material, maps):
    (tmp_path / "a.matcap").touch()
    write_mapset(maps, tmp_path, MapSetInfo("a"))
    assert torch.equal(open_maps(tmp_path).height, maps.height)
    assert torch.equal(open_maps(tmp_path / "a.json").height, maps.height)
    assert material == []


def test_nothing_or_too_much_to_open(tmp_path, material):
    with pytest.raises(MatcapError, match="no map set and no material"):
        open_maps(tmp_path)
    with pytest.raises(MatcapError, match="no such file or folder"):
        open_maps(tmp_path / "none")
    for name in ("a.matcap", "b.matcap"):
        (tmp_path / name).touch()
    with pytest.raises(MatcapError, match=r"2 materials in this folder \(a.matcap, b.matcap\)"):
        open_maps(tmp_path)
