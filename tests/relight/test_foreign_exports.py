"""What matcap exports it reads back as a map set."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from relight_samples import bumpy

from matcap.errors import MatcapError
from matcap.export.job import ExportJob
from matcap.export.targets import write_export
from matcap.files.note import Note
from matcap.relight.foreign.channels import read_channels
from matcap.relight.foreign.read import read_foreign
from matcap.relight.texture import Texture

MAPS = bumpy(48, 32, seed=7, relief=0.05)
MAPS = replace(MAPS, specular=0.0 * MAPS.specular + 0.045)
# The nearest that each can say differs by what its own shading is off from matcap's.
EXACT = ("raw", "polyhaven", "ambientcg", "blender", "mitsuba", "materialx")
SHADED = ("usd", "gltf", "unreal", "unity-hdrp", "unity-urp", "gltf-textures", "godot", "substance")


@pytest.mark.parametrize("target", EXACT + SHADED)
def test_it_is_read_back(tmp_path, target):
    write_export(ExportJob(MAPS, "leather"), target, tmp_path)
    found, whole = read_foreign(tmp_path).texture, Texture.from_maps(MAPS)
    colour = 0.004 if target in EXACT else 0.05
    np.testing.assert_allclose(found.diffuse, whole.diffuse, atol=colour)
    np.testing.assert_allclose(found.roughness, whole.roughness, atol=colour)
    np.testing.assert_allclose(found.specular.mean(0), whole.specular[0], atol=0.02)
    np.testing.assert_allclose(found.slopes, whole.slopes, atol=0.02)
    if target != "gltf":  # which has no place for a height
        np.testing.assert_allclose(found.height, whole.height, atol=1e-4)
    assert found.texel_size == pytest.approx(whole.texel_size)
    assert found.periodic == whole.periodic


@pytest.mark.parametrize("container", ["jpg", "webp", "exr", "tx"])
def test_in_every_kind_of_file(tmp_path, container):
    write_export(ExportJob(MAPS, "leather", container=container), "polyhaven", tmp_path)
    found, whole = read_foreign(tmp_path).texture, Texture.from_maps(MAPS)
    np.testing.assert_allclose(found.specular, whole.specular, atol=0.01)
    assert np.abs(found.diffuse - whole.diffuse).mean() < 0.01
    np.testing.assert_allclose(found.height, whole.height, atol=1e-3)


def test_lengths_in_millimetres_are_brought_back(tmp_path):
    write_export(ExportJob(MAPS, "leather", millimetres=40.0,
                           provenance={"millimetres_per_unit": 40.0}), "raw", tmp_path)  # fmt: skip
    found = read_foreign(tmp_path).texture
    assert found.texel_size == pytest.approx(MAPS.texel_size)
    np.testing.assert_allclose(found.height, MAPS.height, atol=1e-5)


def test_a_damaged_sidecar_is_told(tmp_path):
    write_export(ExportJob(MAPS, "leather"), "raw", tmp_path)
    sidecar = tmp_path / "leather_raw.json"
    sidecar.write_text(sidecar.read_text().replace('"texel": ', '"texel": -'))
    with pytest.raises(MatcapError, match="description is damaged"):
        read_foreign(tmp_path)


def test_a_sidecar_of_another_version_or_none_at_all_is_told(tmp_path):
    write_export(ExportJob(MAPS, "leather"), "godot", tmp_path)
    sidecar = tmp_path / "leather_godot.json"
    stated = sidecar.read_text()
    sidecar.write_text(stated.replace('"version": 2', '"version": 3'))
    with pytest.raises(MatcapError, match="version 3, this matcap reads 2"):
        read_foreign(tmp_path)
    sidecar.write_text(stated[:100])
    with pytest.warns(Note, match="not readable as JSON"):
        by_names = read_channels(tmp_path)
    assert by_names.files["roughness"] == "leather_orm.png"


def test_a_damaged_glb_is_told(tmp_path):
    write_export(ExportJob(MAPS, "leather"), "gltf", tmp_path)
    file = tmp_path / "leather.glb"
    file.write_bytes(file.read_bytes()[:4000])
    with pytest.raises(MatcapError, match="description is damaged"):
        read_foreign(tmp_path)


def test_tiles_of_a_texture_set_are_put_together(tmp_path):
    """Two by two of them, numbered from the left bottom on."""
    grid = np.array([[1011, 1012], [1001, 1002]])
    name = "w_diffuse.<UDIM>.png"
    for number in grid.flat:
        picture = np.full((4, 6, 3), number - 1000, np.uint8)
        cv2.imwrite(str(tmp_path / name.replace("<UDIM>", str(number))), picture)
    sidecar = {
        "format": "matcap export", "version": 2, "target": "raw", "unit": "plane unit",
        "texel": 0.5, "udim": [2, 2], "periodic": False,
        "files": {name: {"meaning": "diffuse albedo", "colour_space": "linear"}},
    }  # fmt: skip
    (tmp_path / "w_raw.json").write_text(json.dumps(sidecar))
    found = read_foreign(tmp_path).texture
    expected = np.kron(grid - 1000, np.ones((4, 6))) / 255.0
    np.testing.assert_allclose(found.diffuse[0], expected, atol=1e-6)
    assert not found.periodic and found.texel_size == 0.5
