"""The scenes, rendered by Mitsuba where the extra `reference` is installed."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from matcap.export.job import ExportJob
from matcap.export.targets import write_export


@pytest.mark.parametrize(("material", "fewest"), [("leather", 4), ("gold", 3)])
def test_every_texture_of_the_scene_exists(tmp_path, made, material, fewest):
    write_export(ExportJob(made[material], "leather"), "mitsuba", tmp_path)
    for scene in ("leather.xml", "leather_exact.xml"):
        root = ET.parse(tmp_path / scene).getroot()
        named = [one.get("value") for one in root.iter("string") if one.get("name") == "filename"]
        assert len(named) >= fewest and all((tmp_path / file).is_file() for file in named)
        # Else integers of 16 bits are kept as half floats.
        textures = [one for one in root.iter("texture") if one.get("type") == "bitmap"]
        stated = [{each.get("name"): each.get("value") for each in one} for one in textures]
        assert all(one["format"] == "variant" for one in stated)


@pytest.mark.programs
@pytest.mark.parametrize("scene", ["{}.xml", "{}_exact.xml"])
def test_mitsubas_rendering_equals_that_of_matcap(tmp_path, made, scene, monkeypatch):
    mi = pytest.importorskip("mitsuba", reason="needs the extra `reference`")
    import matcap

    name = "rust"
    maps = made[name]
    write_export(ExportJob(maps, name), "mitsuba", tmp_path)
    mi.set_variant("scalar_rgb")
    monkeypatch.syspath_prepend(str(tmp_path))
    import matcap_bsdf  # noqa: F401

    # One texel a pixel: what is measured is reflectance, not how pictures are filtered.
    text = (tmp_path / scene.format(name)).read_text()
    nearest = '<string name="filter_type" value="nearest"/><boolean name="raw"'
    (tmp_path / "nearest.xml").write_text(text.replace('<boolean name="raw"', nearest))
    found = np.array(mi.render(mi.load_file(str(tmp_path / "nearest.xml")), spp=8))
    true = matcap.relight(maps, "top", effects="none,+diffuse,+specular,+falloff")
    assert np.abs(found[..., :3] - true).sum() / true.sum() < 0.01
