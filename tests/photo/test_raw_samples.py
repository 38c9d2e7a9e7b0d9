"""Samples of DNGs whose order, levels, crop and metadata LibRaw leaves out or misreads."""

import math
import struct

import numpy as np
import pytest
from simulated.files import beside_preview, gain_map, mosaic, opcode_list, rationals, write_dng

from matcap.errors import MatcapError
from matcap.photo.load import load_photo
from matcap.photo.raw_samples import in_order

SIZE = (96, 128)
GREY = 0.2


def means(path, **options):
    return load_photo(path, noise=False, **options).pixels[4:-4, 4:-4].mean(axis=(0, 1))


@pytest.mark.parametrize("corner", [(0, 0), (1, 0), (0, 1), (3, 5)])
def test_black_by_place_counts_from_the_active_area(tmp_path, corner):
    """LibRaw counts it from the file's corner, and gives it to other colours."""
    black = np.array([[100, 300], [500, 700]])
    top, left = corner
    rows, columns = np.indices(SIZE)
    active = black[rows % 2, columns % 2] + GREY * (4095 - 700)
    stored = np.zeros((SIZE[0] + top, SIZE[1] + left), np.uint16)
    stored[top:, left:] = np.rint(active)
    more = [(50713, 3, 2, (2, 2), True), (50714, 3, 4, tuple(black.ravel()), True)]
    area = (top, left, SIZE[0] + top, SIZE[1] + left)
    path = write_dng(tmp_path / "a.dng", stored, more=more, black=None, active_area=area)
    np.testing.assert_allclose(means(path), GREY, rtol=0.03)


def test_black_levels_by_row_and_column_are_subtracted(tmp_path):
    rows, columns = np.indices(SIZE)
    by_row, by_column = 100 * (np.arange(SIZE[0]) % 7), 50 * (np.arange(SIZE[1]) % 5)
    black = 64 + by_row[rows] + by_column[columns]
    stored = np.rint(black + GREY * (4095 - black.max())).astype(np.uint16)
    more = [
        (50715, 10, SIZE[1], rationals(by_column, 1), True),
        (50716, 10, SIZE[0], rationals(by_row, 1), True),
    ]
    photo = load_photo(write_dng(tmp_path / "a.dng", stored, more=more), noise=False)
    np.testing.assert_allclose(photo.pixels, GREY, rtol=0.01)


def test_levels_by_plane_are_applied(tmp_path):
    black, white = np.array((100, 200, 300)), np.array((4000, 3000, 2000))
    stored = np.rint(black + GREY * (white - black)) * np.ones((*SIZE, 3))
    levels = {"black": tuple(black), "white": tuple(white)}
    path = write_dng(tmp_path / "a.dng", stored.astype(np.uint16), **levels)
    np.testing.assert_allclose(means(path), GREY, rtol=0.01)


def test_interleaved_rows_and_columns(tmp_path, light):
    codes = mosaic(light)
    quadrants = np.block([[codes[r::2, c::2] for c in (0, 1)] for r in (0, 1)])
    np.testing.assert_array_equal(in_order(quadrants, 2, 2), codes)
    thirds = np.concatenate([codes[r::3] for r in range(3)])
    np.testing.assert_array_equal(in_order(thirds, 3, 1), codes)
    more = [(50975, 3, 1, 2, True), (52547, 3, 1, 2, True)]
    path = write_dng(tmp_path / "a.dng", quadrants, more=more)
    expected = load_photo(write_dng(tmp_path / "b.dng", codes), noise=False)
    np.testing.assert_allclose(load_photo(path, noise=False).pixels, expected.pixels, atol=2e-3)


@pytest.mark.parametrize("table", [True, False])
def test_lossy_codes_are_linearised_by_the_file(tmp_path, light, table):
    """LibRaw has one curve for all lossy DNGs."""
    pytest.importorskip("imagecodecs")
    codes = np.rint(255 * (np.sqrt(light) if table else light)).astype(np.uint8)
    square = np.rint(65535 * (np.arange(256) / 255) ** 2).astype(int)
    more = [(50712, 3, 256, tuple(square), True)] if table else []
    lossy = {"compression": 34892, "tile": SIZE, "compressionargs": {"level": 100}}
    white = 65535 if table else 255
    path = write_dng(tmp_path / "a.dng", codes, more=more, black=0, white=white, **lossy)
    np.testing.assert_allclose(load_photo(path, noise=False).pixels, light, atol=0.02)


def value_opcode(opcode, numbers, kind):
    head = struct.pack(">8I", 0, 0, *SIZE, 0, 3, 1, 1)
    count = len(numbers) if opcode == 7 else len(numbers) - 1
    payload = head + struct.pack(">I", count) + np.asarray(numbers, kind).tobytes()
    return struct.pack(">4I", opcode, 0x01030000, 0, len(payload)) + payload


def test_map_table_opcodes_are_applied(tmp_path, light):
    """A polynomial, and a table, of codes that are roots; without a note."""
    stored = np.rint(4095 * np.sqrt(light)).astype(np.uint16)
    squares = np.rint(65535 * (np.arange(65536) / 65535) ** 2)
    for opcode in (value_opcode(8, (0.0, 0.0, 1.0), ">f8"), value_opcode(7, squares, ">u2")):
        path = write_dng(tmp_path / "a.dng", stored, black=0, opcodes2=opcode_list(opcode))
        photo = load_photo(path, noise=False)
        np.testing.assert_allclose(photo.pixels, light, atol=2e-3)
        assert not any("not applied" in note for note in photo.notes)


def test_mosaics_of_other_sizes_are_refused(tmp_path, light):
    path = write_dng(tmp_path / "a.dng", mosaic(light))
    data = bytearray(path.read_bytes())
    at = data.index(struct.pack("<HHI2H", 33421, 3, 2, 2, 2)) + 8
    data[at : at + 4] = struct.pack("<2H", 4, 4)
    path.write_bytes(data)
    with pytest.raises(MatcapError, match="repeats by 4 x 4 photosites is not supported"):
        load_photo(path)


CROP = (50719, 4, 2, (16, 8), True), (50720, 4, 2, (96, 64), True)


def user_crop(*edges):
    return (51125, 5, 4, rationals(edges), True)


@pytest.mark.parametrize("long_side", [None, 64])
def test_default_crop_is_the_picture_that_focal_lengths_refer_to(tmp_path, light, long_side):
    path = write_dng(tmp_path / "a.dng", mosaic(light), more=[*CROP, (41989, 3, 1, 28, True)])
    photo = load_photo(path, noise=False, long_side=long_side)
    assert photo.original_size == (96, 64)
    expected = 2 * math.degrees(math.atan(96 / math.hypot(96, 64) * 43.2666 / 2 / 28))
    assert photo.fov == pytest.approx(expected, abs=0.01)
    if long_side is None:
        np.testing.assert_allclose(photo.pixels[4:-4, 4:-4], light[12:68, 20:108], atol=5e-3)


def test_a_user_s_crop_narrows_the_field_of_view(tmp_path, light):
    more = [*CROP, (41989, 3, 1, 28, True)]
    plain = load_photo(write_dng(tmp_path / "a.dng", mosaic(light), more=more), noise=False)
    square = user_crop(0.0, 1 / 6, 1.0, 5 / 6)
    path = write_dng(tmp_path / "b.dng", mosaic(light), more=[*more, square])
    photo = load_photo(path, noise=False)
    assert photo.original_size == (64, 64)
    reach = math.tan(math.radians(photo.fov / 2)) / math.tan(math.radians(plain.fov / 2))
    assert reach == pytest.approx(64 / 96)
    corner = user_crop(0.0, 0.0, 0.75, 0.75)
    photo = load_photo(write_dng(tmp_path / "c.dng", mosaic(light), more=[*more, corner]))
    assert photo.original_size == (96, 64) and not any("off centre" in note for note in plain.notes)


@pytest.mark.parametrize("first", [1, 3, 8])
def test_orientation_is_the_first_directory_s(tmp_path, light, first):
    """Viewers turn a DNG there; its raw picture's own orientation is no statement."""
    raw = write_dng(tmp_path / "raw.dng", mosaic(light), orientation=6)
    path = beside_preview(raw, tmp_path / "a.dng", mosaic(light), first)
    photo = load_photo(path, noise=False)
    assert photo.turned == (first == 8)
    mean = photo.pixels[4:-4, 4:-4].mean(axis=2)
    left, right = mean[:, :32].mean(), mean[:, -32:].mean()
    assert (left < right) == (first == 1) or first == 8


def test_exif_in_the_first_directory(tmp_path, light):
    more = [
        (33434, 5, 1, (1, 100), True), (33437, 5, 1, (18, 10), True), (34855, 3, 1, 100, True),
        (37385, 3, 1, 1, True), (37386, 5, 1, (45, 10), True), (41989, 3, 1, 18, True),
    ]  # fmt: skip
    photo = load_photo(write_dng(tmp_path / "a.dng", mosaic(light), more=more), noise=False)
    assert photo.fov == pytest.approx(87.7, abs=0.1) and photo.flash_fired is True
    assert photo.exposure == pytest.approx(0.01 * 100 / 1.8**2)


def test_levels_crop_and_shading_together(tmp_path, light):
    """Maps count from the active area, the crop too; LibRaw would misread the levels."""
    black = np.array([[100, 140], [180, 220]])
    gains = np.linspace(1.0, 2.0, 4)[None, :, None] * np.ones((3, 4, 1))
    rows, columns = np.indices(SIZE)
    across = np.interp((columns + 0.5) / SIZE[1], np.linspace(0, 1, 4), gains[0, :, 0])
    shaded = mosaic(light, black=0, white=60000) / 60000 / across
    stored = np.zeros((SIZE[0] + 1, SIZE[1] + 1), np.uint16)
    stored[1:, 1:] = np.rint(black[rows % 2, columns % 2] + shaded * (4095 - 220))
    more = [(50713, 3, 2, (2, 2), True), (50714, 3, 4, tuple(black.ravel()), True), *CROP]
    options = {"active_area": (1, 1, 97, 129), "opcodes2": opcode_list(gain_map(gains, SIZE))}
    path = write_dng(tmp_path / "a.dng", stored, more=more, black=None, **options)
    photo = load_photo(path, noise=False)
    assert photo.gain_map_applied
    np.testing.assert_allclose(photo.pixels[4:-4, 4:-4], light[12:68, 20:108], atol=0.01)


@pytest.mark.parametrize("side", [0, 65535])
def test_a_pattern_of_black_levels_that_no_sensor_has_is_refused(tmp_path, light, side):
    """Before memory for it is asked for."""
    more = [(50713, 3, 2, (side, side), True)]
    path = write_dng(tmp_path / "a.dng", mosaic(light), more=more)
    with pytest.raises(MatcapError, match="truncated or damaged"):
        load_photo(path)
