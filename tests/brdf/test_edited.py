"""Map sets of which another program opened and saved a map."""

import struct
import warnings

import numpy as np
import pytest
import torch
from other_exr import write_other_exr

from matcap.brdf.folder import MapSetInfo, read_mapset, write_mapset
from matcap.errors import MatcapError
from matcap.files.exr import read_exr
from matcap.files.note import Note
from matcap.files.rec709 import REC709

INFO = MapSetInfo("leather")


def resave(file, *planes, names="RGBA"):
    write_other_exr(file, dict(zip(names, planes, strict=False)))


@pytest.fixture
def written(tmp_path, maps):
    write_mapset(maps, tmp_path, INFO)
    return tmp_path, read_mapset(tmp_path)[0]


def quietly(folder):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return read_mapset(folder)[0]


def same(found, expected):
    assert torch.equal(found.stacked(), expected.stacked())


def test_an_opaque_alpha_is_left_out_of_every_map(written):
    folder, expected = written
    for kind in ("diffuse", "specular", "roughness", "height", "normal"):
        file = folder / f"leather_{kind}.exr"
        found = read_exr(file).pixels
        planes = [*np.moveaxis(found, -1, 0)]
        planes = planes if len(planes) == 3 else planes * 3
        resave(file, *planes, np.ones(found.shape[:2]))
    same(quietly(folder), expected)


def test_grey_as_grey_and_alpha_or_as_three_channels(written):
    folder, expected = written
    (plane,) = np.moveaxis(read_exr(folder / "leather_roughness.exr").pixels, -1, 0)
    resave(folder / "leather_roughness.exr", plane, np.ones_like(plane), names="YA")
    (plane,) = np.moveaxis(read_exr(folder / "leather_height.exr").pixels, -1, 0)
    resave(folder / "leather_height.exr", plane, plane, plane)
    same(quietly(folder), expected)


def test_a_transparent_alpha_is_told(written):
    folder, expected = written
    planes = np.moveaxis(read_exr(folder / "leather_diffuse.exr").pixels, -1, 0)
    resave(folder / "leather_diffuse.exr", *planes, np.full(planes[0].shape, 0.5))
    with pytest.warns(Note, match="transparency is not used"):
        same(read_mapset(folder)[0], expected)


def test_a_colour_where_there_can_be_none_is_refused(written):
    folder, _ = written
    (plane,) = np.moveaxis(read_exr(folder / "leather_roughness.exr").pixels, -1, 0)
    resave(folder / "leather_roughness.exr", plane, 0.9 * plane, plane)
    with pytest.raises(MatcapError, match="3 channels instead of 1"):
        read_mapset(folder)


def test_primaries_of_another_program_are_converted(written):
    folder, expected = written
    file = folder / "leather_diffuse.exr"
    stored = file.read_bytes()
    rec709, p3 = (
        struct.pack("<8f", *one)
        for one in (REC709, (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290))
    )
    assert rec709 in stored
    file.write_bytes(stored.replace(rec709, p3))
    with pytest.warns(Note, match="primaries"):
        found = read_mapset(folder)[0]
    to_rec709 = np.array(
        [[1.2249, -0.2247, 0.0], [-0.0420, 1.0419, 0.0], [-0.0197, -0.0786, 1.0979]]
    )
    converted = np.tensordot(to_rec709, expected.diffuse.numpy(), 1)
    np.testing.assert_allclose(found.diffuse, np.maximum(converted, 0.0), atol=2e-3)
    file.write_bytes(stored.replace(rec709, struct.pack("<8f", *[0.3] * 8)))
    with pytest.raises(MatcapError, match="no colour space"):
        read_mapset(folder)
