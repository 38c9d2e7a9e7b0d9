"""All targets of export."""

import filecmp
import json
import re
import shlex
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from exported import MATERIALS, METALS
from materials import a_material
from simulated.materials import realise
from target_surfaces import every, of_maps, residual

from matcap.brdf.edited import seam_ratio
from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.brdf.maps import MapSet
from matcap.cli.main import main
from matcap.errors import MatcapError, UsageError
from matcap.example.example import Example
from matcap.example.exemplar import Exemplar
from matcap.export.job import ExportJob, material_reach
from matcap.export.options import ExportOptions
from matcap.export.presets import PRESETS
from matcap.export.shading import DIRECTIONS, TargetShading, TargetSurface, compared, shine_all
from matcap.export.targets import DOCUMENTS, export_mapset, write_export
from matcap.field.opened import open_material, open_tile

# What all exports have in common, and every command of docs/guide/export.md.


# What is exported to the others is read again for all materials, in the tests of each.
KEPT = [(target, name) for target in ("blender", "mitsuba") for name in (*MATERIALS, *METALS)]
KEPT += [(target, name) for target in DOCUMENTS for name in ("leather", "gold")]


@pytest.mark.parametrize(("target", "name"), sorted(set(KEPT)))
def test_targets_with_the_same_model_keep_the_maps(made, written, target, name):
    folder, done = written(target, name)
    assert done.residual is not None
    # Browsers read 8 bits of a binary's 16, which polished granite shows.
    assert done.residuals.get("read with 16 bits", done.residual).mean < 0.01
    assert {file.name for file in folder.iterdir()} == set(done.files)
    sidecar = json.loads((folder / f"{name}_{target}.json").read_text())
    assert sidecar["residual"]["mean"] == done.residual.mean
    width, height = made[name].size
    assert sidecar["tile"] == pytest.approx([2.0, 2.0 * height / width])
    assert all((folder / file).is_file() for file in sidecar["files"])


@pytest.mark.parametrize("target", DOCUMENTS)
def test_the_same_maps_give_the_same_bytes(tmp_path, made, written, target):
    write_export(ExportJob(made["leather"], "leather"), target, tmp_path)
    before = written(target, "leather")[0]
    names = sorted(file.name for file in before.iterdir())
    assert names == sorted(file.name for file in tmp_path.iterdir())
    assert filecmp.cmpfiles(before, tmp_path, names, shallow=False) == (names, [], [])


@pytest.mark.parametrize("target", DOCUMENTS)
def test_broken_maps_leave_nothing(tmp_path, made, target):
    broken = made["leather"].map(lambda map_: map_.clone())
    broken.specular[0, 3, 4] = float("nan")
    with pytest.raises(MatcapError, match="not finite"):
        write_export(ExportJob(broken, "leather"), target, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("target", ["usd", "gltf"])
def test_floats_are_refused_where_none_can_be(tmp_path, made, target):
    with pytest.raises(UsageError, match="no float textures"):
        options = ExportOptions(bits="half")
        write_export(ExportJob(made["leather"], "leather", options=options), target, tmp_path)


def test_a_known_size_goes_into_every_export(tmp_path, made):
    info = MapSetInfo("leather", provenance={"millimetres_per_unit": 85.0})
    write_mapset(made["leather"], tmp_path, info)
    for target in DOCUMENTS:
        done = export_mapset(tmp_path, target)
        assert not any("not measured" in note for note in done.notes)
        sidecar = json.loads((tmp_path / target / f"leather_{target}.json").read_text())
        assert sidecar["unit"] == "mm" and sidecar["tile"][0] == pytest.approx(170.0)


def test_the_range_of_heights_is_that_of_the_material(tmp_path, made, monkeypatch):
    height = made["leather"].height
    there = SimpleNamespace(generator=SimpleNamespace(piece=lambda: made["leather"]))
    monkeypatch.setattr("matcap.field.material.Material.load", lambda _: there)
    (tmp_path / "tiny.matcap").touch()
    reach = material_reach(tmp_path / "tiny.matcap", "anything")
    assert 1.2 * height.abs().max() < reach < 1.6 * height.abs().max()
    assert material_reach(tmp_path, "tiny") == reach  # of a map set beside it
    assert material_reach(tmp_path, "other") is None


def test_a_broken_material_beside_the_maps_is_ignored(tmp_path):
    (tmp_path / "tiny.matcap").write_bytes(b"no material")
    assert material_reach(tmp_path, "tiny") is None


PAGE = (Path(__file__).parents[2] / "docs" / "guide" / "export.md").read_text(encoding="utf-8")
SHELL = "".join(re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)).splitlines()
EXPORTS = [line for line in SHELL if line.startswith("matcap export")]


LEATHER = MapSetInfo("leather", provenance={"made": "up"})


@pytest.fixture
def captured(tmp_path, monkeypatch, made):
    """What a capture leaves, but for its size."""
    write_mapset(made["leather"], tmp_path / "out" / "leather", LEATHER)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("line", EXPORTS)
def test_exported_commands_run(captured, line):
    assert main(shlex.split(line)[1:]) == 0


ENDS = {"materialx": ".mtlx", "gltf": ".glb", "usd": ".usd", "blender": ".py", "mitsuba": ".xml"}


@pytest.mark.parametrize("target", ENDS)
def test_file_names_are_those_of_the_guide(captured, target, capsys):
    assert any(f"--to {target}" in line for line in EXPORTS)
    assert main(["export", "out/leather", "--to", target]) == 0
    said = capsys.readouterr()
    assert said.out == "" and f"wrote leather_{target} (" in said.err
    there = {file.name for file in (captured / f"leather_{target}").iterdir()}
    named = re.findall(r"`(leather[\w.]*\.(?:mtlx|glb|usd[az]|py|xml))`", PAGE)
    mine = {name for name in named if ENDS[target] in name}
    assert mine and mine <= there
    sidecar = json.loads((captured / f"leather_{target}/leather_{target}.json").read_text())
    assert sidecar["provenance"] == {"made": "up"}


@pytest.mark.parametrize("preset", PRESETS)
def test_file_names_of_presets_are_those_of_the_table(captured, preset):
    (row,) = re.findall(rf"^\| `{preset}` \| (.*?) \|", PAGE, re.MULTILINE)
    forms = PRESETS[preset]
    for form in forms:
        asked = ["--workflow", form] if form else []
        assert main(["export", "out/leather", "--to", preset, *asked, "-q", "--overwrite"]) == 0
    there = " ".join(file.name for file in (captured / f"leather_{preset}").iterdir())
    assert (parts := re.findall(r"`([^`]+)`", row))
    for part in parts:
        wanted = re.sub("1k", "48", part, flags=re.IGNORECASE)  # 48 texels here, 1024 there
        assert wanted.split(".")[0] in there


# Six materials repeat without a seam: as a capture's first map set, and in exports.

SEAMLESS = 1.15  # invisible: single lines of a texture scatter by as much
WIDTH, HEIGHT = 256, 192


def by_example(name):
    """A material that rearranges a simulated piece."""
    maps = realise(name, WIDTH, HEIGHT, 1, 2.0 / WIDTH)
    exemplar = Exemplar.certain(maps.stacked().float().numpy(), 2.0 / WIDTH)
    return a_material(name, example=Example.of(exemplar))


@pytest.mark.parametrize("name", ["leather", "cloth", "tile"])
def test_a_materials_tile_has_no_seam_and_exports_say_so(tmp_path, name):
    by_example(name).save(tmp_path / f"{name}.matcap")
    found = open_tile(tmp_path, size=(256, 256))
    assert found.maps.periodic and seam_ratio(found.maps) <= SEAMLESS
    if name == "leather":
        found = open_tile(tmp_path, size=(48, 48))
        for target in (*DOCUMENTS, "raw", "unreal"):
            done = write_export(ExportJob(found.maps, found.name), target, tmp_path / target)
            sidecar = json.loads((tmp_path / target / f"{name}_{target}.json").read_text())
            assert sidecar["periodic"] is True and sidecar["seam"] <= SEAMLESS
            assert not any("seam" in note for note in done.notes)


def test_an_export_of_a_cut_notes_its_seam(tmp_path):
    by_example("leather").save(tmp_path / "leather.matcap")
    maps = open_material(tmp_path)[1].maps(100, 100)
    assert seam_ratio(maps) > SEAMLESS
    done = write_export(ExportJob(maps, "leather"), "gltf", tmp_path / "gltf")
    assert any("have a seam" in note for note in done.notes)


# The residual of conversions: it sees every way in which a target can be wrong.


@pytest.mark.parametrize("name", MATERIALS)
def test_an_export_of_tiling_maps_notes_no_seam(made, name):
    off = residual(made[name], of_maps(made[name]))
    assert off.mean == off.worst == 0.0


CHANGES = {
    "diffuse": lambda s: {"diffuse": s.diffuse * 1.1},
    "f0": lambda s: {"f0": s.f0 * 1.5},
    "roughness": lambda s: {"roughness": s.roughness * 1.1},
    "normal": lambda s: {"normal": s.normal * torch.tensor([1.0, -1.0, 1.0])[:, None, None]},
    "f90": lambda s: {"f90": 0.5},
    "separable": lambda s: {"shading": TargetShading(masking="separable")},
    "hammon": lambda s: {"shading": TargetShading(masking="hammon")},
    "disney": lambda s: {"shading": TargetShading(diffuse="disney")},
    "index": lambda s: {"shading": TargetShading(index=0.04)},
    "mobile": lambda s: {"shading": TargetShading(specular="mobile")},
    "compensated": lambda s: {"shading": TargetShading(compensated=True)},
    "half": lambda s: {"shading": TargetShading(layer="half"), "layer": s.f0},
    "albedo": lambda s: {"shading": TargetShading(layer="albedo"), "layer": s.f0},
}


@pytest.mark.parametrize("change", CHANGES)
def test_lights_at_once_are_those_one_by_one(made, change):
    true = every(of_maps(made["rust"]), 1)
    theirs = replace(true, **CHANGES[change](true))
    ours = [true.shine(*at) for at in DIRECTIONS]
    more = [theirs.shine(*at) - one for at, one in zip(DIRECTIONS, ours, strict=True)]
    off, light = (np.array([float(values.abs().sum()) for values in one]) for one in (more, ours))
    found = compared(shine_all(true), theirs)
    assert found.mean == pytest.approx(off.sum() / light.sum(), rel=1e-12)
    assert found.worst == pytest.approx((off / light).max(), rel=1e-12)


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_of_any_parameter_has_a_residual(made, change):
    true = of_maps(made["rust"])
    assert residual(made["rust"], replace(true, **CHANGES[change](true))).worst > 1e-3


def test_ten_percent_more_albedo_is_ten_percent_more_radiance(made):
    maps = made["leather"]
    black = MapSet(maps.diffuse, 0.0 * maps.specular, maps.roughness, maps.height, 1e9)
    rest = black.specular, black.roughness, black.normal
    both = (TargetSurface(factor * maps.diffuse, *rest, f90=0.0) for factor in (1.1, 1.0))
    light = torch.tensor([0.0, 0.6, 0.8], dtype=torch.float64)[:, None, None]
    more, less = (every(one, 1).shine(light, light) for one in both)
    assert torch.allclose(more, 1.1 * less, rtol=1e-6)


def test_the_surface_of_targets_equals_the_reflectance_of_matcap(made):
    from matcap.brdf.cook_torrance import cook_torrance, dot

    maps = made["rust"].map(lambda map_: map_.double())
    light = torch.tensor([0.48, 0.36, 0.8], dtype=torch.float64)[:, None, None]
    view = torch.tensor([-0.6, 0.0, 0.8], dtype=torch.float64)[:, None, None]
    full = [v.expand_as(maps.normal) for v in (light, view)]
    args = maps.diffuse, maps.specular, maps.roughness, maps.normal
    expected = cook_torrance(*args, *full) * dot(maps.normal, full[0])
    found = of_maps(maps).shine(light, view)
    assert torch.allclose(found, expected.clamp_min(0.0), rtol=1e-6, atol=1e-9)
