"""`matcap export` and `--export`: from a material or a map set to another program's files."""

import json

import pytest
from materials import a_material
from random_maps import random_maps

from matcap.brdf.folder import MapSetInfo, write_mapset


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A map set called moss, in a folder of its own beside which commands run."""
    write_mapset(random_maps(24, 16), tmp_path / "set", MapSetInfo("moss"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def material(tmp_path, monkeypatch):
    """A small material, beside which commands run."""
    path = tmp_path / "noise.matcap"
    a_material("noise", across=64).save(path)
    monkeypatch.chdir(tmp_path)
    return path


def test_loose_textures_are_exported(matcap, folder):
    said = matcap(
        "export", "set", "--to", "polyhaven", "--normal", "both", "--bits", "8", "-o", "out", "-q",
    )  # fmt: skip
    assert (said.code, said.out, said.err) == (0, "", "")
    names = {file.name for file in (folder / "out").iterdir()}
    wanted = {"moss_diff_24.png", "moss_nor_gl_24.png", "moss_nor_dx_24.png"}
    assert names >= wanted | {"moss_polyhaven.json"}


def test_a_workflow_that_a_target_lacks_is_refused(matcap, folder):
    found = matcap("export", "set", "--to", "blender", "--workflow", "metallic")
    assert found.code == 2
    assert "--workflow: blender has no metallic workflow; leave it out." in found.err


def test_files_of_other_formats(matcap, folder):
    assert matcap("export", "set", "--to", "raw", "--format", "jpg", "-o", "out").code == 0
    assert (folder / "out" / "moss_diffuse.jpg").is_file()
    found = matcap("export", "set", "--to", "gltf", "--format", "exr")
    assert found.code == 2 and "--format: glTF cannot hold exr; give png or jpg." in found.err


def test_json_states_what_is_lost(matcap, folder):
    said = matcap("export", "set", "--to", "unity-hdrp", "--json", "--workflow", "metallic")
    assert (said.code, said.err) == (0, "")
    report = json.loads(said.out)
    assert report["residual"]["worst"] > report["residual"]["mean"] > 0.01
    assert report["workflow"] == "metallic"
    assert report["residuals"]["specular"]["mean"] < report["residuals"]["metallic"]["mean"]
    assert "moss_MaskMap.png" in report["files"] and report["folder"] == "moss_unity-hdrp"


def test_real_lengths_are_exported(matcap, folder):
    assert matcap("export", "set", "--to", "materialx", "--unit", 120).code == 0
    sidecar = json.loads((folder / "moss_materialx" / "moss_materialx.json").read_text())
    assert (sidecar["unit"], sidecar["tile"]) == ("mm", pytest.approx([240.0, 160.0]))


def test_a_material_is_made_into_maps_that_tile(matcap, material, tmp_path):
    from matcap.field.opened import open_tile

    said = matcap("export", material, "--to", "gltf", "--size", "48x32", "--seed", 3)
    assert said.code == 0 and (tmp_path / "noise_gltf_48x32_seed3" / "noise.glb").is_file()
    assert open_tile(material, size=(48, 32), seed=3).maps.periodic
    assert not open_tile(material, size=(40, 32), seed=3).maps.periodic


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        ([], 2, "--to: no target is given; choose from materialx, usd, gltf, "),
        (
            ["--to", "usd", "--unit", "nan"],
            2,
            "--unit: nan is out of range; give between 1e-06 and 1e+09.",
        ),
        (["--to", "usd", "--seed", "9" * 25], 2, "is out of range"),
        (["--to", "usd", "--size", "99999999"], 2, "has a side of more than 65536"),
        (["--to", "gtlf"], 2, "--to: there is no 'gtlf'; did you mean 'gltf'."),
        (["--to", "usd", "--to", "gltf"], 2, "--to: one target at a time; run the command once"),
        (["--to", "unreal-engine"], 2, "did you mean 'unreal'."),
        (["--to", "unral"], 2, "--to: there is no 'unral'; did you mean 'unreal'."),
        (
            ["--to", "usd", "--normal", "dx"],
            2,
            "--normal: only textures alone have this option, and usd has a document; leave it out.",
        ),
        (
            ["--to", "usd", "--bits", "half"],
            2,
            "--bits: a .usdz has no float textures; give 8 or 16.",
        ),
        (["--to", "usd", "-o", "set/moss.json"], 3, "a file stands where a folder is needed"),
    ],
)
def test_failures_are_one_sentence_and_leave_nothing(matcap, folder, arguments, code, said):
    before = sorted(folder.rglob("*"))
    found = matcap("export", "set", *arguments)
    assert found.code == code and said in found.err
    assert found.err.count("\n") == 1 or "Usage:" in found.err
    assert sorted(folder.rglob("*")) == before


def test_a_folder_without_maps_is_refused(matcap, tmp_path):
    found = matcap("export", tmp_path, "--to", "usd", "-o", tmp_path / "out")
    assert found.code == 3 and "no map set and no material" in found.err
    assert list(tmp_path.iterdir()) == []


def test_synth_exports_too(matcap, material, tmp_path):
    said = matcap(
        "synth", material, "--size", "48x32", "--tile", "--mip", "-o", "set", "--export",
        "materialx", "-j", "1",
    )  # fmt: skip
    assert said.code == 0, said.err
    assert (tmp_path / "set" / "materialx" / "noise.mtlx").is_file()
    said = matcap("synth", material, "--udim", "2x1", "--export", "raw", "-o", "other")
    assert said.code == 2 and "a texture set cannot be exported" in said.err
    assert not (tmp_path / "other").exists()


def test_synth_writes_the_textures_of_engines(material, matcap, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    area = ("--size", "32x32", "-o", "set")
    matcap("synth", material, *area, "--maps", "png", "--normal", "dx")
    assert len([*(tmp_path / "set" / "maps").glob("*.png")]) == 6
    assert len([*(tmp_path / "set" / "maps").glob("*_normal_dx.png")]) == 1


def test_capture_exports_too(matcap, pipeline, photo, tmp_path):
    said = matcap(
        "capture", photo, "-o", tmp_path / "out", "--size", "32", "--export", "gltf",
        "--export", "unreal",
    )  # fmt: skip
    assert said.code == 0 and (tmp_path / "out" / "leather" / "gltf" / "leather.glb").is_file()
    assert (tmp_path / "out" / "leather" / "unreal" / "T_leather_ORM.png").is_file()
    sidecar = json.loads((tmp_path / "out" / "leather" / "gltf" / "leather_gltf.json").read_text())
    assert sidecar["periodic"] is True and sidecar["seam"] > 0.0


def test_capture_refuses_unknown_targets_before_any_work(matcap, pipeline, photo, tmp_path):
    said = matcap("capture", photo, "-o", tmp_path / "out", "--export", "blendr")
    assert said.code == 2 and "--export: there is no 'blendr'; did you mean 'blender'." in said.err
    assert pipeline.calls == [] and not (tmp_path / "out").exists()


def test_a_size_of_a_map_set_is_refused_and_an_earlier_export_is_kept(matcap, folder):
    said = matcap("export", "set", "--to", "gltf", "--size", "2K")
    assert said.code == 2 and "--size: this is a map set" in said.err
    assert matcap("export", "set", "--to", "gltf", "-o", "out").code == 0
    said = matcap("export", "set", "--to", "gltf", "-o", "out")
    assert said.code == 3 and "this exists already" in said.err
    assert matcap("export", "set", "--to", "gltf", "-o", "out", "--overwrite").code == 0


def test_an_unknown_target_lists_all_targets(matcap, folder):
    from matcap.export.targets import TARGETS

    said = matcap("export", "set", "--to", "qqqqqq")
    assert said.code == 2 and all(f"{target}" in said.err for target in TARGETS)


def test_unreal_is_plain_unless_substrate_is_asked_for(matcap, folder):
    for words, form in (((), "metallic"), (("--workflow", "specular"), "specular")):
        said = matcap("export", "set", "--to", "unreal", "-o", form, *words, "--json")
        assert json.loads(said.out)["workflow"] == form
