"""Six materials repeat without a seam: as a capture's first map set, and in exports."""

import json

import numpy as np
import pytest
from materials import a_material
from simulated.materials import MATERIALS, realise

from matcap.brdf.seam import seam_ratio
from matcap.example.example import Example
from matcap.example.exemplar import Exemplar
from matcap.export.job import ExportJob
from matcap.export.targets import DOCUMENTS, write_export
from matcap.field.opened import open_material, open_tile

SEAMLESS = 1.15  # invisible: single lines of a texture scatter by as much
WIDTH, HEIGHT = 256, 192


def by_example(name):
    """A material that rearranges a simulated piece."""
    maps = realise(name, WIDTH, HEIGHT, 1, 2.0 / WIDTH)
    piece = {
        kind: np.ascontiguousarray(getattr(maps, kind).float().numpy())
        for kind in ("diffuse", "specular", "roughness", "height")
    }
    sure = np.ones((4, HEIGHT, WIDTH), np.float32)
    exemplar = Exemplar(**piece, confidence=sure, texel_size=2.0 / WIDTH)
    return a_material(name, example=Example.of(exemplar))


@pytest.mark.parametrize("name", MATERIALS)
def test_a_materials_tile_has_no_seam_and_exports_say_so(tmp_path, name):
    by_example(name).save(tmp_path / f"{name}.matcap")
    found = open_tile(tmp_path, size=(256, 256))
    assert found.maps.periodic and seam_ratio(found.maps) <= SEAMLESS
    if name == "leather":
        found = open_tile(tmp_path, size=(64, 64))
        for target in (*DOCUMENTS, "raw", "unreal"):
            job = ExportJob(found.maps, found.name)
            done = write_export(job, target, tmp_path / target)
            sidecar = json.loads((tmp_path / target / f"{name}_{target}.json").read_text())
            assert sidecar["periodic"] is True and sidecar["seam"] <= SEAMLESS
            assert not any("seam" in note for note in done.notes)


def test_what_is_cut_from_the_endless_field_has_a_seam_which_an_export_tells(tmp_path):
    by_example("leather").save(tmp_path / "leather.matcap")
    maps = open_material(tmp_path)[1].maps(200, 200)
    assert seam_ratio(maps) > SEAMLESS
    done = write_export(ExportJob(maps, "leather"), "gltf", tmp_path / "gltf")
    assert any("have a seam" in note for note in done.notes)
