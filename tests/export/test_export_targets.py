"""What all exports have in common, and every command of docs/guide/export.md."""

import filecmp
import json
import re
import shlex
from pathlib import Path
from types import SimpleNamespace

import pytest
from exported import MATERIALS, METALS

from matcap.brdf.folder import MapSetInfo, write_mapset
from matcap.cli.main import main
from matcap.errors import MatcapError, UsageError
from matcap.export.engines import PRESETS
from matcap.export.job import ExportJob, material_reach
from matcap.export.targets import DOCUMENTS, export_mapset, write_export

# What is exported to the others is read again for all materials, in the tests of each.
KEPT = [(target, name) for target in ("blender", "mitsuba") for name in (*MATERIALS, *METALS)]
KEPT += [(target, name) for target in DOCUMENTS for name in ("leather", "gold")]


@pytest.mark.parametrize(("target", "name"), sorted(set(KEPT)))
def test_targets_that_know_the_model_keep_it(tmp_path, made, target, name):
    done = write_export(ExportJob(made[name], name), target, tmp_path / "out")
    assert done.residual is not None
    # Browsers read 8 bits of a binary's 16, which polished granite shows.
    assert done.residuals.get("read with 16 bits", done.residual).mean < 0.01
    assert {file.name for file in (tmp_path / "out").iterdir()} == set(done.files)
    sidecar = json.loads((tmp_path / "out" / f"{name}_{target}.json").read_text())
    assert sidecar["residual"]["mean"] == done.residual.mean
    width, height = made[name].size
    assert sidecar["tile"] == pytest.approx([2.0, 2.0 * height / width])
    assert all((tmp_path / "out" / file).is_file() for file in sidecar["files"])


@pytest.mark.parametrize("target", DOCUMENTS)
def test_the_same_maps_give_the_same_bytes(tmp_path, made, target):
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        write_export(ExportJob(made["leather"], "leather"), target, folder)
    for file in folders[0].iterdir():
        assert filecmp.cmp(file, folders[1] / file.name, shallow=False)


@pytest.mark.parametrize("target", DOCUMENTS)
def test_broken_maps_leave_nothing(tmp_path, made, target):
    broken = made["leather"].map(lambda map_: map_.clone())
    broken.specular[0, 3, 4] = float("nan")
    with pytest.raises(MatcapError, match="not finite"):
        write_export(ExportJob(broken, "leather"), target, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_unknown_targets_name_the_nearest(tmp_path, made):
    with pytest.raises(UsageError, match="did you mean 'unreal'"):
        write_export(ExportJob(made["leather"], "leather"), "unral", tmp_path)


@pytest.mark.parametrize("target", ["usd", "gltf"])
def test_floats_are_refused_where_none_can_be(tmp_path, made, target):
    with pytest.raises(UsageError, match="no float textures"):
        write_export(ExportJob(made["leather"], "leather", depth="half"), target, tmp_path)


def test_a_known_size_goes_into_every_export(tmp_path, made):
    info = MapSetInfo("leather", provenance={"millimetres_per_unit": 85.0})
    write_mapset(made["leather"], tmp_path, info)
    for target in DOCUMENTS:
        done = export_mapset(tmp_path, target)
        assert not any("not measured" in note for note in done.notes)
        sidecar = json.loads((tmp_path / target / f"leather_{target}.json").read_text())
        assert sidecar["unit"] == "mm"
        assert sidecar["tile"][0] == pytest.approx(170.0)


def test_a_material_fixes_the_range_of_its_heights(tmp_path, made, monkeypatch):
    height = made["leather"].height
    there = SimpleNamespace(generator=SimpleNamespace(piece=lambda: made["leather"]))
    monkeypatch.setattr("matcap.field.material.Material.load", lambda _: there)
    (tmp_path / "tiny.matcap").touch()
    reach = material_reach(tmp_path / "tiny.matcap", "anything")
    assert 1.2 * height.abs().max() < reach < 1.6 * height.abs().max()
    assert material_reach(tmp_path, "tiny") == reach  # of a map set beside it
    assert material_reach(tmp_path, "other") is None


def test_a_broken_material_beside_the_maps_has_no_say(tmp_path):
    (tmp_path / "tiny.matcap").write_bytes(b"no material")
    assert material_reach(tmp_path, "tiny") is None


PAGE = (Path(__file__).parents[2] / "docs" / "guide" / "export.md").read_text(encoding="utf-8")
SHELL = "".join(re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)).splitlines()
# Of a map set; what needs a material (--udim) is tried in tests/cli.
EXPORTS = [line for line in SHELL if line.startswith("matcap export") and "--udim" not in line]


LEATHER = MapSetInfo("leather", provenance={"made": "up"})


@pytest.fixture
def captured(tmp_path, monkeypatch, made):
    """What a capture leaves, but for its size."""
    write_mapset(made["leather"], tmp_path / "out" / "leather", LEATHER)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("line", EXPORTS)
def test_commands_run(captured, line):
    assert main(shlex.split(line)[1:]) == 0


ENDS = {"materialx": ".mtlx", "gltf": ".glb", "usd": ".usd", "blender": ".py", "mitsuba": ".xml"}


@pytest.mark.parametrize("target", ENDS)
def test_files_are_called_as_the_page_says(captured, target, capsys):
    assert any(f"--to {target}" in line for line in EXPORTS)
    assert main(["export", "out/leather", "--to", target]) == 0
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith(f"wrote leather_{target} (")
    there = {file.name for file in (captured / f"leather_{target}").iterdir()}
    named = re.findall(r"`(leather[\w.]*\.(?:mtlx|glb|usd[az]|py|xml))`", PAGE)
    mine = {name for name in named if ENDS[target] in name}
    assert mine and mine <= there
    sidecar = json.loads((captured / f"leather_{target}/leather_{target}.json").read_text())
    assert sidecar["provenance"] == {"made": "up"}


@pytest.mark.parametrize("preset", PRESETS)
def test_files_of_presets_are_called_as_the_table_says(captured, preset):
    (row,) = re.findall(rf"^\| `{preset}` \| (.*?) \|", PAGE, re.MULTILINE)
    forms = PRESETS[preset]
    for form in forms:
        asked = ["--workflow", form] if form else []
        assert main(["export", "out/leather", "--to", preset, *asked, "-q", "--overwrite"]) == 0
    there = " ".join(file.name for file in (captured / f"leather_{preset}").iterdir())
    for part in re.findall(r"`([^`]+)`", row):
        wanted = re.sub("1k", "48", part, flags=re.IGNORECASE)  # 48 texels here, 1024 there
        assert wanted.split(".")[0] in there
