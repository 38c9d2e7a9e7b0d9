"""Binaries and stages as three.js and Babylon.js draw them, against `matcap relight`."""

import pytest
import render_babylon
import render_three
from exported import unlike

from matcap.export.targets import write_export
from matcap.export.textures import ExportJob


@pytest.mark.parametrize(
    ("library", "target", "suffix", "limit"),
    [
        (render_three, "gltf", "glb", 0.01),
        (render_three, "usd", "usda", 0.04),
        (render_babylon, "gltf", "glb", 0.01),
    ],
)
@pytest.mark.parametrize("material", ["leather", "rust"])
def test_its_picture_is_matcaps(tmp_path, made, material, library, target, suffix, limit):
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if not library.PLACE.is_dir():
        pytest.skip(f"needs `npm install --prefix .node {library.PLACE.name}`")
    import matcap
    from matcap.relight.scene import NAMED_LIGHTS, exposing_intensity

    maps, light = made[material], NAMED_LIGHTS["top"]
    write_export(ExportJob(maps, material), target, tmp_path)
    try:
        found = library.render(
            tmp_path / f"{material}.{suffix}", maps, light, exposing_intensity(light)
        )
    except api.Error as error:
        if "Executable" not in str(error):
            raise
        pytest.skip(f"no Chromium ({str(error).splitlines()[0]})")
    true = matcap.relight(maps, "top", effects="none,+diffuse,+specular,+falloff")
    assert unlike(found, true) < limit
