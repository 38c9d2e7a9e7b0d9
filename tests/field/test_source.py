"""Opening whatever a user points at."""

from types import SimpleNamespace

import pytest
import torch

from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.errors import MatcapError, UsageError
from matcap.field.opened import open_maps, open_tile


@pytest.fixture
def material(monkeypatch, maps):
    """Material.load gives something whose maps are known; it takes any file."""
    asked = []

    def load(path):
        def read(width, height, *, seed, generator):
            asked.append((path.name, width, height, seed, generator))
            return maps

        return SimpleNamespace(maps=read)

    monkeypatch.setattr("matcap.field.material.Material.load", load)
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


def test_a_folder_means_its_material_and_a_map_sets_file_that_map_set(tmp_path, material, maps):
    write_mapset(maps, tmp_path, MapSetInfo("a"))
    assert torch.equal(open_maps(tmp_path).height, maps.height)
    assert material == []
    (tmp_path / "a.matcap").touch()
    assert open_maps(tmp_path) is maps
    assert len(material) == 1
    assert torch.equal(open_maps(tmp_path / "a.json").height, maps.height)
    assert len(material) == 1


def test_a_size_or_seed_asked_of_a_map_set_is_refused_by_name(tmp_path, maps):
    write_mapset(maps, tmp_path, MapSetInfo("a"))
    assert open_tile(tmp_path).name == "a"
    for option, value in {"size": (64, 64), "seed": 0, "generator": "decoder"}.items():
        with pytest.raises(UsageError, match=f"--{option}: this is a map set"):
            open_tile(tmp_path, **{option: value})


def test_nothing_or_too_much_to_open(tmp_path, material):
    with pytest.raises(MatcapError, match="no map set and no material"):
        open_maps(tmp_path)
    with pytest.raises(MatcapError, match="no such file or folder"):
        open_maps(tmp_path / "none")
    for name in ("a.matcap", "b.matcap"):
        (tmp_path / name).touch()
    with pytest.raises(MatcapError, match=r"2 materials in this folder \(a.matcap, b.matcap\)"):
        open_maps(tmp_path)
