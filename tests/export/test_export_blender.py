"""Exports read by Blender and three.js."""

import json
import re
from unittest.mock import MagicMock

import pytest
import render_three
from chromium import if_installed
from exported import unlike

from matcap.export.job import ExportJob
from matcap.export.targets import write_export

# The script, by what it asks for; how Blender itself renders it is in docs/notes/exports.md.


def test_every_file_of_the_script_exists(tmp_path, made):
    import ast

    write_export(ExportJob(made["leather"], "leather", 85.0), "blender", tmp_path)
    code = (tmp_path / "leather_blender.py").read_text()
    ast.parse(code)
    sidecar = json.loads((tmp_path / "leather_blender.json").read_text())
    kinds = set(re.findall(r'texture\("(\w+)"', code)) | set(re.findall(r'files\["(\w+)"', code))
    assert kinds == set(sidecar["textures"])
    assert all((tmp_path / file).is_file() for file in sidecar["textures"].values())
    assert sidecar["texel"] == pytest.approx(85.0 * 2.0 / 48) and sidecar["height"] == 32
    assert sidecar["height_code"] == {"scale": 85.0, "midlevel": 0.0, "unit": "mm"}


@pytest.mark.parametrize(("unit", "width"), [(85.0, 0.17), (None, 2.0)])
def test_the_plane_and_the_relief_are_in_metres(tmp_path, made, monkeypatch, unit, width):
    """Millimetres taken for metres made a leather of 170 metres."""
    import importlib.util
    import sys

    done = write_export(ExportJob(made["leather"], "leather", unit), "blender", tmp_path)
    assert any("not measured" in note for note in done.notes) == (unit is None)
    corner, blender = MagicMock(), MagicMock()
    corner.co.x, corner.co.y = 0.5, 0.5
    blender.context.object.data.vertices = [corner]
    corner.uv.x, corner.uv.y = 1.0, 1.0
    blender.context.object.data.uv_layers.active.data = [corner]
    monkeypatch.setitem(sys.modules, "bpy", blender)
    spec = importlib.util.spec_from_file_location("script", tmp_path / "leather_blender.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    script.plane(MagicMock(), tmp_path / "leather_blender.json")
    assert 2.0 * corner.co.x == pytest.approx(width)
    assert (corner.uv.x, corner.uv.y) == (1.0, 1.0)  # one tile
    assert 2.0 * corner.co.y == pytest.approx(width * 32 / 48)
    about = json.loads((tmp_path / "leather_blender.json").read_text())
    assert script.lifted(about) == pytest.approx(width / 2.0)


# Binaries and stages as three.js draws them, against `matcap relight`.


@pytest.mark.programs
@pytest.mark.parametrize(
    ("target", "suffix", "limit", "result"),
    [
        ("gltf", "glb", 0.01, {}),
        # three.js doubles a stage's relief: it takes the texture's scale for the normals' strength.
        # What is left is the bounces, which a stage read elsewhere must not make up for.
        ("usd", "usda", 0.025, {"plain_normals": True}),
    ],
)
@pytest.mark.parametrize("material", ["leather", "rust"])
def test_blenders_rendering_equals_that_of_matcap(
    tmp_path, made, material, target, suffix, limit, result
):
    if not render_three.PLACE.is_dir():
        pytest.skip(f"needs `npm install --prefix .node {render_three.PLACE.name}`")
    import matcap
    from matcap.relight.scene import NAMED_LIGHTS, exposing_intensity

    maps, light = made[material], NAMED_LIGHTS["top"]
    write_export(ExportJob(maps, material), target, tmp_path)
    with if_installed():
        found = render_three.render(
            tmp_path / f"{material}.{suffix}", maps, light, exposing_intensity(light), **result
        )
    true = matcap.relight(maps, "top", effects="none,+diffuse,+specular,+falloff")
    assert unlike(found, true) < limit
