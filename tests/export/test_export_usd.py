"""The stage and the package through usd-core."""

import struct
import zipfile

import pytest
from exported import MATERIALS, METALS
from target_surfaces import residual

from matcap.export.job import ExportJob
from matcap.export.targets import write_export


@pytest.fixture
def read_usd():
    pytest.importorskip("pxr", reason="needs the extra `export`")
    import read_usd

    return read_usd


@pytest.mark.parametrize(("material", "name"), [("leather", "2001 façade-1"), ("gold", "gold")])
def test_it_is_valid(tmp_path, made, read_usd, material, name):
    write_export(ExportJob(made[material], name, millimetres=90.0), "usd", tmp_path)
    for suffix in ("usda", "usdz"):
        assert read_usd.complaints(tmp_path / f"{name}.{suffix}") == []


def test_the_validators_would_object(tmp_path, made, read_usd):
    write_export(ExportJob(made["leather"], "leather"), "usd", tmp_path)
    file = tmp_path / "leather.usda"
    file.write_text(file.read_text().replace("color3f inputs:diff", "float inputs:diff"))
    assert read_usd.complaints(file)


@pytest.mark.parametrize("name", ["leather", "gold", "copper"])
def test_its_materialx_is_materialxs(tmp_path, made, read_usd, name):
    pytest.importorskip("MaterialX", reason="needs the extra `export`")
    write_export(ExportJob(made[name], "leather"), "usd", tmp_path)
    file, wrong = tmp_path / "leather.usda", tmp_path / "wrong.usda"
    assert read_usd.misnamed(file) == []
    wrong.write_text(file.read_text().replace("inputs:specular_ior", "inputs:specular_IOR"))
    assert read_usd.misnamed(wrong) == ["/leather/Material/OpenPBR.specular_IOR"]


@pytest.mark.parametrize("name", [*MATERIALS, *METALS])
def test_its_network_gives_the_light_of_the_maps(tmp_path, made, read_usd, name):
    write_export(ExportJob(made[name], name), "usd", tmp_path)
    for suffix in ("usda", "usdz"):
        off = residual(made[name], read_usd.surface(tmp_path / f"{name}.{suffix}"))
        assert off.mean < 0.01
        assert off.worst < 0.02
        for file in tmp_path.glob("*.png"):
            file.unlink()  # so that only the package's own can be read


@pytest.mark.parametrize(("unit", "metres"), [(None, 1.0), (90.0, 0.09)])
def test_heights_are_real(tmp_path, made, read_usd, unit, metres):
    from pxr import Usd, UsdGeom

    write_export(ExportJob(made["leather"], "leather", unit), "usd", tmp_path)
    stage = Usd.Stage.Open(str(tmp_path / "leather.usda"))
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


def test_files_lie_at_multiples_of_64_bytes(tmp_path, made):
    write_export(ExportJob(made["leather"], "leather"), "usd", tmp_path)
    path = tmp_path / "leather.usdz"
    content = path.read_bytes()
    with zipfile.ZipFile(path) as package:
        assert package.testzip() is None
        assert package.namelist()[0] == "leather.usda"
        for info in package.infolist():
            assert info.compress_type == zipfile.ZIP_STORED
            name, extra = struct.unpack_from("<HH", content, info.header_offset + 26)
            assert (info.header_offset + 30 + name + extra) % 64 == 0
