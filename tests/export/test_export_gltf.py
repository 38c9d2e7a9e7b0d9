"""glTF and USD exports."""

import shutil
import struct
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import torch
from exported import MATERIALS, METALS
from read_gltf import complaints, has_validator, opened, surface
from target_surfaces import residual

from matcap.brdf.maps import MapSet
from matcap.export.job import ExportJob
from matcap.export.options import ExportOptions
from matcap.export.targets import write_export
from matcap.export.texture_file import TextureFile
from matcap.export.textures import picture as plain

# The glTF binary: its light, its plane, and Khronos's validator.


def job_of(made, name, unit=None, **options):
    return ExportJob(made[name], name, unit, ExportOptions(**options))


@pytest.mark.parametrize(
    ("name", "depth"),
    [*((name, depth) for name in MATERIALS for depth in (None, "8", "16")),
     *((name, None) for name in METALS)],
)  # fmt: skip
def test_the_material_gives_the_reflectance_of_the_maps(tmp_path, made, name, depth):
    done = write_export(job_of(made, name, bits=depth), "gltf", tmp_path)
    ways = {
        "specular": {"compensated": True, "browsers": True},
        "read with 16 bits": {"compensated": True},
        "of a single bounce": {},
    }
    assert done.residual == done.residuals["specular"]
    for said, way in ways.items():
        off = residual(made[name], surface(tmp_path / f"{name}.glb", **way))
        assert off.mean == pytest.approx(done.residuals[said].mean, rel=1e-3)
        if depth != "8" and not way.get("browsers"):
            assert off.mean < (0.01 if way else 0.03)


def test_the_upper_byte_of_sixteen_bits_is_the_nearest(tmp_path):
    """Browsers drop the lower byte, which made roughness less by half a step on average."""
    code = torch.linspace(0.0, 1.0, 64 * 64).reshape(1, 64, 64)
    job = ExportJob(MapSet((0.0 * code).expand(3, 64, 64), code, code, 0.0 * code, 0.1), "even")
    texture = replace(TextureFile.of(job, plain("roughness"), "16", ""), eight_of_16=True)
    stored, meant = texture.stored(job.piece()), job.picture("roughness")
    assert np.abs((stored >> 8) / 255.0 - meant).max() < 0.501 / 255.0
    assert np.abs(stored / 65535.0 - meant).max() < 0.501 / 255.0
    middle = np.abs(meant - 0.5) < 0.25  # as of normals
    assert np.abs(stored / 65535.0 - meant)[middle].mean() < 0.1 / 255.0
    assert np.array_equal(texture.in_browsers().stored(job.piece()), stored >> 8)


def test_the_plane_is_as_large_as_the_maps(tmp_path, made):
    write_export(ExportJob(made["leather"], "leather", millimetres=90.0), "gltf", tmp_path)
    document, view = opened(tmp_path / "leather.glb")
    (primitive,) = document["meshes"][0]["primitives"]
    accessor = document["accessors"][primitive["attributes"]["POSITION"]]
    assert accessor["max"] == pytest.approx([0.09, 0.06, 0.0])
    points = np.frombuffer(view(accessor["bufferView"]), dtype="<f4").reshape(-1, 3)
    assert points.max(axis=0) == pytest.approx(accessor["max"])
    indices = document["accessors"][primitive["indices"]]["bufferView"]
    faces = np.frombuffer(view(indices), dtype="<u2").reshape(-1, 3)
    a, b, c = (points[faces[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0.0).all()  # both triangles face the viewer
    spots = document["accessors"][primitive["attributes"]["TEXCOORD_0"]]
    uv = np.frombuffer(view(spots["bufferView"]), dtype="<f4").reshape(-1, 2)
    top = points[:, 1] > 0.0
    assert (uv[top, 1] == 0.0).all()  # a picture's first row is the top
    assert (uv[~top, 1] == 1.0).all()


@pytest.mark.parametrize("f0", [0.0, 0.04, 0.2, 0.95, 1.0])
def test_every_f0_is_kept(tmp_path, f0):
    flat = torch.zeros(1, 8, 8)
    maps = MapSet(flat.expand(3, 8, 8), flat + f0, flat + 0.5, flat, 0.1)
    done = write_export(ExportJob(maps, "even"), "gltf", tmp_path)
    # What bounces between microfacets is made up for on average, not for every direction.
    assert done.residuals["read with 16 bits"].mean < 0.016
    assert done.residuals["read with 16 bits"].worst < 0.03


def test_radiance_beyond_the_layers_of_gltf_is_noted(tmp_path):
    flat = torch.zeros(1, 8, 8)
    maps = MapSet(flat.expand(3, 8, 8) + 0.9, flat + 0.5, flat + 0.5, flat, 0.1)
    job = ExportJob(maps, "bright", options=ExportOptions(workflow="specular"))
    done = write_export(job, "gltf", tmp_path)
    assert "clipped" in done.notes[0] and done.residual.mean > 0.1


@pytest.mark.skipif(
    not has_validator(), reason="needs node, and `npm install --prefix .node gltf-validator`"
)
@pytest.mark.parametrize("depth", ["8", "16"])
def test_the_gltf_validator_reports_no_error(tmp_path, made, depth):
    write_export(job_of(made, "rust", 85.0, bits=depth), "gltf", tmp_path)
    assert complaints(tmp_path / "rust.glb") == []
    broken = (tmp_path / "rust.glb").read_bytes().replace(b'"VEC3"', b'"VEC4"')
    (tmp_path / "rust.glb").write_bytes(broken)
    assert complaints(tmp_path / "rust.glb")


def test_jpg_textures_make_a_smaller_file(tmp_path, made):
    import cv2

    sizes = {}
    for one in (None, "jpg"):
        folder = tmp_path / str(one)
        write_export(job_of(made, "rust", container=one), "gltf", folder)
        sizes[one] = (folder / "rust.glb").stat().st_size
    assert sizes["jpg"] < 0.8 * sizes[None]
    document, view = opened(folder / "rust.glb")
    for image in document["images"]:
        raw = np.frombuffer(view(image["bufferView"]), dtype=np.uint8)
        assert cv2.imdecode(raw, cv2.IMREAD_UNCHANGED).shape[:2] == (32, 48)
    if has_validator():
        assert complaints(folder / "rust.glb") == []


def test_viewers_without_extensions_get_a_metallic_material(tmp_path, made):
    done = write_export(job_of(made, "leather", workflow="metallic"), "gltf", tmp_path)
    assert done.workflow == "metallic"
    document, _ = opened(tmp_path / "leather.glb")
    assert document["extensionsUsed"] == ["KHR_materials_ior"] and done.residual.mean < 0.04


# The stage and the package through usd-core.


@pytest.fixture
def read_usd():
    pytest.importorskip("pxr", reason="needs the extra `export`")
    import read_usd

    return read_usd


@pytest.mark.parametrize(("material", "name"), [("leather", "2001 façade-1"), ("gold", "gold")])
def test_usd_is_valid(tmp_path, made, read_usd, material, name):
    write_export(ExportJob(made[material], name, millimetres=90.0), "usd", tmp_path)
    for suffix in ("usda", "usdz"):
        assert read_usd.complaints(tmp_path / f"{name}.{suffix}") == []


def test_the_usd_validators_reject_a_broken_stage(tmp_path, written, read_usd):
    file = shutil.copytree(written("usd", "leather")[0], tmp_path / "out") / "leather.usda"
    file.write_text(file.read_text().replace("color3f inputs:diff", "float inputs:diff"))
    assert read_usd.complaints(file)


@pytest.mark.parametrize("name", ["leather", "gold", "copper"])
def test_the_materialx_of_usd_equals_that_of_materialx(tmp_path, written, read_usd, name):
    pytest.importorskip("MaterialX", reason="needs the extra `export`")
    file, wrong = written("usd", name)[0] / f"{name}.usda", tmp_path / "wrong.usda"
    assert read_usd.misnamed(file) == []
    wrong.write_text(file.read_text().replace("inputs:specular_ior", "inputs:specular_IOR"))
    assert read_usd.misnamed(wrong) == [f"/{name}/Material/OpenPBR.specular_IOR"]


@pytest.mark.parametrize("name", [*MATERIALS, *METALS])
def test_the_usd_network_gives_the_reflectance_of_the_maps(tmp_path, made, written, read_usd, name):
    stage = written("usd", name)[0] / f"{name}.usda"
    # Elsewhere, so that only the package's own textures can be read.
    package = shutil.copy(stage.with_suffix(".usdz"), tmp_path)
    for file in (stage, package):
        off = residual(made[name], read_usd.surface(file))
        assert off.mean < 0.01 and off.worst < 0.02


@pytest.mark.parametrize(("unit", "metres"), [(None, 1.0), (90.0, 0.09)])
def test_heights_of_usd_are_in_metres(made, written, read_usd, unit, metres):
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(written("usd", "leather", unit)[0] / "leather.usda"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    plane = UsdGeom.Mesh(stage.GetDefaultPrim().GetChild("Plane"))
    assert max(p[0] for p in plane.GetPointsAttr().Get()) == pytest.approx(metres)
    material = stage.GetDefaultPrim().GetChild("Material")
    chosen = material.GetVariantSets().GetVariantSet("displacement")
    assert chosen.GetVariantSelection() == "off"
    assert not read_usd.shader(stage).GetInput("displacement")
    chosen.SetVariantSelection("on")
    height = made["leather"].height * metres
    found = read_usd.read(read_usd.shader(stage), "displacement")
    assert (found - height).abs().max() < 1e-4 * float(height.max() - height.min())


def test_files_in_a_usdz_start_at_multiples_of_64_bytes(written):
    path = written("usd", "leather")[0] / "leather.usdz"
    content = path.read_bytes()
    with zipfile.ZipFile(path) as package:
        assert package.testzip() is None and package.namelist()[0] == "leather.usda"
        for info in package.infolist():
            assert info.compress_type == zipfile.ZIP_STORED
            name, extra = struct.unpack_from("<HH", content, info.header_offset + 26)
            assert (info.header_offset + 30 + name + extra) % 64 == 0
