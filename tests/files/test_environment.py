"""Pictures of surroundings as cameras, renderers and libraries write them."""

import struct

import numpy as np
import pytest
from other_exr import write_other_exr
from PIL import Image

from matcap.errors import MatcapError
from matcap.files.color import srgb_decode
from matcap.files.exr import write_exr
from matcap.files.names import Note
from matcap.relight.environment_map import read_picture

ROWS, COLUMNS = 8, 16
PICTURE = np.random.default_rng(0).uniform(0.1, 4.0, (ROWS, COLUMNS, 3)).astype(np.float32)


def exr(path, picture, **header):
    return write_other_exr(path, {"RGB": picture}, **header)


def radiance(path, stored, *lines, resolution=f"-Y {ROWS} +X {COLUMNS}", form="rgbe"):
    """Flat, uncompressed texels of (scanlines, texels, 3) light."""
    exponent = np.ceil(np.log2(stored.max(axis=-1)))
    mantissa = np.floor(stored / 2.0 ** exponent[..., None] * 256.0).clip(0, 255)
    texels = np.concatenate([mantissa, exponent[..., None] + 128], axis=-1).astype(np.uint8)
    head = "\n".join(("#?RADIANCE", f"FORMAT=32-bit_rle_{form}", *lines, "", resolution, ""))
    path.write_bytes(head.encode() + texels.tobytes())
    return path


def near(found, expected, scale=1.0):
    """RGBE is off by a 256th of a texel's largest channel as stored."""
    off = np.abs(found - expected).max(axis=-1) / expected.max(axis=-1)
    assert off.max() < 2.0 * scale / 256.0


ORIENTATIONS = {
    f"-Y {ROWS} +X {COLUMNS}": PICTURE,
    f"+Y {ROWS} +X {COLUMNS}": PICTURE[::-1],
    f"-Y {ROWS} -X {COLUMNS}": PICTURE[:, ::-1],
    f"+Y {ROWS} -X {COLUMNS}": PICTURE[::-1, ::-1],
    f"+X {COLUMNS} -Y {ROWS}": PICTURE.transpose(1, 0, 2),
    f"+X {COLUMNS} +Y {ROWS}": PICTURE[::-1].transpose(1, 0, 2),
    f"-X {COLUMNS} -Y {ROWS}": PICTURE[:, ::-1].transpose(1, 0, 2),
    f"-X {COLUMNS} +Y {ROWS}": PICTURE[::-1, ::-1].transpose(1, 0, 2),
}


@pytest.mark.parametrize("resolution", ORIENTATIONS)
def test_radiance_files_are_oriented_by_their_resolution_line(tmp_path, resolution):
    file = radiance(tmp_path / "a.hdr", ORIENTATIONS[resolution], resolution=resolution)
    near(read_picture(file), PICTURE)


def test_radiance_exposures_multiply(tmp_path):
    stored = PICTURE * 6.0 * np.array([1.0, 2.0, 0.5], np.float32)
    lines = ("EXPOSURE=2.0", "EXPOSURE= 3.0", "COLORCORR= 1.0 2.0 0.5")
    near(read_picture(radiance(tmp_path / "a.hdr", stored, *lines)), PICTURE, 4.0)


def test_radiance_files_in_xyz_are_converted(tmp_path):
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    file = radiance(tmp_path / "a.hdr", PICTURE @ np.transpose(to_xyz), form="xyze")
    with pytest.warns(Note, match="primaries"):
        found = read_picture(file)
    assert np.abs(found - PICTURE).max() < 0.08  # quantised before the matrix


@pytest.mark.parametrize(
    ("line", "resolution"),
    [("EXPOSURE=none", ""), ("EXPOSURE=0", ""), ("FORMAT=64-bit", ""), ("", "8 x 16"),
     ("", "-Y 8 +Y 16"), ("", "-Y 99999 +X 99999")],
)  # fmt: skip
def test_damaged_radiance_files_are_refused(tmp_path, line, resolution):
    more = {"resolution": resolution} if resolution else {}
    file = radiance(tmp_path / "a.hdr", PICTURE, *[line] * bool(line), **more)
    with pytest.raises(MatcapError, match=r"damaged|more than can be read"):
        read_picture(file)


def test_small_negative_radiance_is_clipped_with_a_note(tmp_path):
    picture = PICTURE.copy()
    picture[2, 3:5, 1] = -0.003
    with pytest.warns(Note, match=r"2 pixels are negative, down to -0.003"):
        found = read_picture(exr(tmp_path / "a.exr", picture))
    np.testing.assert_array_equal(found, np.maximum(picture, 0.0))


def test_mostly_below_zero_or_not_finite_is_refused(tmp_path):
    with pytest.raises(MatcapError, match="no radiance"):
        read_picture(exr(tmp_path / "a.exr", PICTURE * [1.0, -3.0, 1.0]))
    picture = PICTURE.copy()
    picture[0, 0] = np.inf
    with pytest.raises(MatcapError, match="not finite"):
        read_picture(exr(tmp_path / "b.exr", picture))


def test_texels_outside_of_the_data_window_are_black(tmp_path):
    window = (np.array([0, 0], np.int32), np.array([COLUMNS - 1, ROWS - 1], np.int32))
    data = (np.array([2, 0], np.int32), np.array([COLUMNS + 1, 3], np.int32))
    file = exr(tmp_path / "a.exr", PICTURE[:4], displayWindow=window, dataWindow=data)
    with pytest.warns(Note, match="a part of its picture"):
        found = read_picture(file)
    expected = np.zeros_like(PICTURE)
    expected[:4, 2:] = PICTURE[:4, :-2]
    np.testing.assert_array_equal(found, expected)


def test_code_values_are_decoded_with_a_note(tmp_path):
    Image.new("RGB", (COLUMNS, ROWS), (128, 128, 128)).save(tmp_path / "a.png")
    with pytest.warns(Note, match="code values"):
        found = read_picture(tmp_path / "a.png")
    np.testing.assert_allclose(found, srgb_decode(np.array(128 / 255)), rtol=1e-5)


def test_primaries_are_converted(tmp_path):
    picture = np.zeros((ROWS, COLUMNS, 3)) + [1.0, 0.5, 0.25]
    rec2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
    file = exr(tmp_path / "a.exr", picture, chromaticities=rec2020)
    with pytest.warns(Note, match="primaries"):
        found = read_picture(file)
    np.testing.assert_allclose(found[0, 0], [1.3486, 0.4398, 0.2113], atol=2e-3)


def as_cube(file):
    """The attribute envmap, which OpenEXR's Python cannot write, in place of another as long."""
    whole = file.read_bytes()
    stand_in = b"xxxxxx\0string\0" + struct.pack("<I", 1) + b"A"
    assert whole.count(stand_in) == 1
    file.write_bytes(whole.replace(stand_in, b"envmap\0envmap\0" + struct.pack("<I", 1) + b"\1"))
    return file


@pytest.mark.parametrize("size", [(64, 64), (64, 48), (96, 16)])
def test_other_projections_are_refused(tmp_path, size):
    write_exr(tmp_path / "a.exr", np.ones((size[1], size[0], 3), np.float32), half=True)
    with pytest.raises(MatcapError, match="twice as wide"):
        read_picture(tmp_path / "a.exr")
    with pytest.raises(MatcapError, match="a cube map"):
        read_picture(as_cube(exr(tmp_path / "b.exr", np.ones((5, 4, 3)), xxxxxx="A")))
