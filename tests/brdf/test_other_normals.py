"""A normal file that was edited is told of, not silently left."""

import json
import warnings

import numpy as np
import pytest
import torch

from matcap.brdf.adjust import Adjustments, adjusted
from matcap.brdf.folder import MapSetInfo, read_mapset, write_mapset
from matcap.errors import MatcapError
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
    write_exr(file, change(read_exr(file).pixels).astype(np.float32), half=False)
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


@pytest.mark.parametrize("style", ["gl", "dx"])
def test_what_was_painted_is_read_where_it_is_asked_for(tmp_path, maps, style):
    write_mapset(maps, tmp_path, MapSetInfo("moss"), normal=style)
    file = tmp_path / "moss_normal.exr"
    normals = read_exr(file).pixels
    normals[5:15, 5:15] = (0.36, 0.48 if style == "gl" else -0.48, 0.8)
    write_exr(file, 2.0 * normals, half=False)  # of no unit length
    found, _ = read_mapset(tmp_path, normals="file")
    assert torch.allclose(found.normal[:, 10, 10], torch.tensor([0.36, 0.48, 0.8]), atol=1e-3)
    assert torch.allclose(found.normal[:, :4], maps.normal[:, :4], atol=2e-3)
    assert torch.equal(found.crop(5, 5, 4, 4).normal[:, 0, 0], found.normal[:, 5, 5])


def test_relief_that_is_adjusted_takes_the_painting_along(tmp_path, maps):
    write_mapset(maps, tmp_path, MapSetInfo("moss"))
    found, _ = read_mapset(tmp_path, normals="file")
    steeper = adjusted(found, Adjustments(relief=2.0)).normal
    assert torch.allclose(
        steeper[:2] / steeper[2:], 2.0 * found.normal[:2] / found.normal[2:], atol=1e-5
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda normals: normals[:10], "is 31 x 10 texels"),
        (lambda normals: normals[..., 0], "has 1 channels"),
        (lambda normals: -normals, "normals of 620 texels do not face upwards"),
        (lambda normals: 0.0 * normals, "normals of 620 texels"),
    ],
)
def test_what_is_no_normal_is_refused_where_it_is_asked_for(tmp_path, maps, change, said):
    write_mapset(maps, tmp_path, MapSetInfo("moss"))
    file = tmp_path / "moss_normal.exr"
    write_exr(file, change(read_exr(file).pixels).astype(np.float32), half=False)
    with pytest.raises(MatcapError, match=f"moss_normal.exr.*{said}"):
        read_mapset(tmp_path, normals="file")
