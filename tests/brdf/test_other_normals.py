"""A normal file that was edited is told of, not silently left."""

import json
import warnings

import numpy as np
import pytest

from matcap.brdf.folder import MapSetInfo, read_mapset, write_mapset
from matcap.files.exr import read_exr, write_exr
from matcap.files.note import Note


@pytest.mark.parametrize("normal", ["gl", "dx"])
def test_a_set_as_it_was_written_has_no_note(tmp_path, maps, normal):
    write_mapset(maps, tmp_path, MapSetInfo("moss"), normal=normal)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_mapset(tmp_path)


def painted(normals):
    normals[5:15, 5:15] = (0.6, 0.0, 0.8)
    return normals


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (painted, "differs from the height at 1[0-9]"),
        (lambda normals: normals[:10], "is 31 x 10 texels, not 31 x 20"),
        (lambda normals: normals[..., 0], "differs from the height at 100"),
        (lambda normals: normals * np.array([1, -1, 1]), "differs from the height at"),
    ],
)
def test_an_edited_normal_is_told(tmp_path, maps, change, said):
    write_mapset(maps, tmp_path, MapSetInfo("moss"))
    file = tmp_path / "moss_normal.exr"
    write_exr(file, change(read_exr(file)).astype(np.float32), half=False)
    with pytest.warns(Note, match=f"moss_normal.exr: {said}.*it is not read"):
        read_mapset(tmp_path)


def test_normals_that_are_none_are_told(tmp_path, maps):
    import OpenEXR

    write_mapset(maps, tmp_path, MapSetInfo("moss"))
    broken = np.full((20, 31, 3), np.nan, np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": broken}).write(str(tmp_path / "moss_normal.exr"))
    with pytest.warns(Note, match="has values that are not finite"):
        read_mapset(tmp_path)


def test_a_set_without_a_normal_file_is_whole(tmp_path, maps):
    file = write_mapset(maps, tmp_path, MapSetInfo("moss"))
    document = json.loads(file.read_text())
    del document["maps"]["normal"]
    file.write_text(json.dumps(document))
    read_mapset(tmp_path)
