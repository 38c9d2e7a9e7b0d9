"""DNGs that LibRaw cannot open come out as LibRaw would have made them."""

import sys

import numpy as np
import pytest
from dng_files import BLACK, WHITE, color_matrix, gain_map, mosaic, opcode_list, write_dng

from matcap.errors import MatcapError
from matcap.photo.dng import read_corrections
from matcap.photo.jxl import read_with_tifffile
from matcap.photo.load import load_photo

NEUTRAL = (0.5, 1.0, 0.6)
JPEG_XL = 52546


@pytest.mark.parametrize("planes", [1, 3])
def test_same_numbers_as_libraw(tmp_path, light, planes):
    mixing = np.array([[0.7, 0.25, 0.05], [0.2, 0.7, 0.1], [0.05, 0.25, 0.7]])
    camera = light @ mixing.T * NEUTRAL
    linear = np.rint(BLACK + camera * (WHITE - BLACK)).astype(np.uint16)
    gains = opcode_list(gain_map(np.full((2, 2, 1), 1.5), (96, 128), planes=planes))
    path = write_dng(
        tmp_path / "a.dng",
        mosaic(camera) if planes == 1 else linear,
        neutral=NEUTRAL,
        color_matrix=color_matrix(mixing),
        orientation=3,
        opcodes2=gains,
    )
    ours = read_with_tifffile(path, None, read_corrections(path))
    libraw = load_photo(path)
    assert ours.orientation == 3
    inner = np.s_[4:-4, 4:-4]  # the two demosaic the border differently
    np.testing.assert_allclose(ours.pixels[::-1, ::-1][inner], libraw.pixels[inner], atol=4e-3)


def test_clipping_follows_white_balance(tmp_path):
    light = np.full((96, 128, 3), 0.2)
    light[:, :64, 0] = 0.6
    samples = np.rint(BLACK + light * (WHITE - BLACK)).astype(np.uint16)
    path = write_dng(tmp_path / "a.dng", samples, neutral=(0.5, 1.0, 1.0))
    ours = read_with_tifffile(path, None, read_corrections(path))
    np.testing.assert_array_equal(ours.clipped, np.indices((96, 128))[1] < 64)


@pytest.mark.parametrize("planes", [1, 3])
def test_reads_jpeg_xl(tmp_path, light, planes):
    pytest.importorskip("imagecodecs")
    samples = mosaic(light) if planes == 1 else np.rint(light * WHITE).astype(np.uint16)
    options = {"compression": JPEG_XL, "compressionargs": {"level": 0, "lossless": True}}
    photo = load_photo(write_dng(tmp_path / "a.dng", samples, **options))
    plain = write_dng(tmp_path / "b.dng", samples)
    inner = np.s_[4:-4, 4:-4]
    np.testing.assert_allclose(photo.pixels[inner], load_photo(plain).pixels[inner], atol=4e-3)
    assert photo.radiometric


def test_missing_extra_names_its_command(tmp_path, light, monkeypatch):
    path = write_dng(tmp_path / "a.dng", mosaic(light))
    data = path.read_bytes()
    # No encoder needed: the compression is written over, the picture never reached.
    at = data.index(b"\x03\x01\x03\x00\x01\x00\x00\x00\x01\x00") + 8
    path.write_bytes(data[:at] + JPEG_XL.to_bytes(2, "little") + data[at + 2 :])
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    with pytest.raises(MatcapError, match=r'pip install "matcap\[jxl\]"') as caught:
        load_photo(path)
    assert isinstance(caught.value.__cause__, ImportError)
