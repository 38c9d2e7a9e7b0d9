"""Binaries and stages as three.js draws them, against `matcap relight`."""

import pytest
import render_three
from chromium import if_installed
from exported import unlike

from matcap.export.job import ExportJob
from matcap.export.targets import write_export


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
def test_its_picture_is_matcaps(tmp_path, made, material, target, suffix, limit, result):
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
