"""Binaries and stages as three.js draws them, against `matcap relight`."""

import numpy as np
import pytest
from render_three import THREE, render

from matcap.export.targets import write_export
from matcap.export.textures import ExportJob

BLOCK = 16  # pixels, averaged: what is measured is the material, not how pictures are filtered


def averaged(image):
    height, width = (side // BLOCK * BLOCK for side in image.shape[:2])
    parts = image[:height, :width].reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK, 3)
    return parts.mean(axis=(1, 3))


@pytest.mark.skipif(not THREE.is_dir(), reason="needs `npm install --prefix .node three`")
@pytest.mark.parametrize(
    ("target", "suffix", "limit"), [("gltf", "glb", 0.01), ("usd", "usda", 0.04)]
)
def test_its_picture_is_matcaps(tmp_path, made, target, suffix, limit):
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    import matcap
    from matcap.relight.scene import NAMED_LIGHTS, exposing_intensity

    maps, light = made["leather"], NAMED_LIGHTS["top"]
    write_export(ExportJob(maps, "leather"), target, tmp_path)
    try:
        found = render(tmp_path / f"leather.{suffix}", maps, light, exposing_intensity(light))
    except api.Error as error:
        if "Executable" not in str(error):
            raise
        pytest.skip(f"no Chromium ({str(error).splitlines()[0]})")
    true = matcap.relight(maps, "top", effects="none,+diffuse,+specular,+falloff")
    off = np.abs(averaged(found) - averaged(true)).sum() / averaged(true).sum()
    assert off < limit
