"""The document through MaterialX's own library, and its shader as Chromium draws it."""

import json
import shutil

import numpy as np
import pytest
from chromium import if_installed
from exported import MATERIALS, METALS
from target_surfaces import residual

from matcap.export.job import ExportJob
from matcap.export.targets import write_export
from matcap.files.exr import read_exr

VARIANTS = ("", "_openpbr", "_standard_surface")


@pytest.fixture
def read_materialx():
    pytest.importorskip("MaterialX", reason="needs the extra `export`")
    import read_materialx

    return read_materialx


@pytest.mark.parametrize("name", [*MATERIALS, "gold"])
def test_the_document_is_valid(written, read_materialx, name):
    folder, _ = written("materialx", name, 85.0)
    for variant in VARIANTS:
        assert read_materialx.complaints(folder / f"{name}{variant}.mtlx") == []


def test_the_validator_rejects_a_broken_document(tmp_path, written, read_materialx):
    file = shutil.copytree(written("materialx", "leather")[0], tmp_path / "out") / "leather.mtlx"
    file.write_text(file.read_text().replace('nodename="alpha"', 'nodename="alfa"'))
    assert read_materialx.complaints(file)


@pytest.mark.parametrize("name", [*MATERIALS, *METALS])
def test_the_graph_gives_the_reflectance_of_the_maps(made, written, read_materialx, name):
    file = written("materialx", name)[0] / f"{name}.mtlx"
    assert residual(made[name], read_materialx.surface(file)).worst < 1e-3


def test_a_shader_is_generated_from_the_document(written, read_materialx):
    document = read_materialx.load(written("materialx", "leather")[0] / "leather.mtlx")
    code = read_materialx.shader(document, "point").getSourceCode("pixel")
    assert "mx_generalized_schlick_bsdf(closureData" in code
    assert "mx_layer_bsdf(closureData" not in code


@pytest.mark.programs
@pytest.mark.parametrize(
    ("variant", "limit"), [("", 1e-3), ("_openpbr", 0.01), ("_standard_surface", 0.01)]
)
def test_the_rendering_equals_that_of_matcap(tmp_path, made, read_materialx, variant, limit):
    """MaterialX's shader, drawn by Chromium, against `matcap relight`."""
    import matcap
    from matcap.relight.scene import NAMED_LIGHTS, PointLight, exposing_intensity

    maps, place = made["rust"], NAMED_LIGHTS["top"]
    write_export(ExportJob(maps, "rust"), "materialx", tmp_path)
    light = PointLight(place, (exposing_intensity(place),) * 3)
    with if_installed():
        found = read_materialx.render(
            tmp_path / f"rust{variant}.mtlx", maps, light, compensated=bool(variant)
        )
    true = matcap.relight(maps, "top", effects="none,+diffuse,+specular,+falloff")
    assert np.abs(found - true).sum() / true.sum() < limit


@pytest.mark.parametrize(("unit", "metres"), [(None, 1.0), (85.0, 0.085)])
def test_heights_are_in_metres(made, written, read_materialx, unit, metres):
    folder, _ = written("materialx", "leather", unit)
    document = read_materialx.load(folder / "leather.mtlx")
    graph = document.getNodeGraph("NG_matcap")
    lift = graph.getOutput("displacement_out").getConnectedNode()
    assert lift.getInput("scale").getValue() == pytest.approx(metres)
    assert lift.getInput("scale").getUnit() == ("meter" if unit else "")
    file = lift.getConnectedNode("displacement").getInput("file").getValueString()
    assert np.array_equal(read_exr(folder / file).pixels[..., 0], made["leather"].height[0])
    sidecar = json.loads((folder / "leather_materialx.json").read_text())
    assert sidecar["unit"] == ("mm" if unit else "plane unit")
    assert sidecar["tile"][0] == pytest.approx(2.0 * (unit or 1.0))
