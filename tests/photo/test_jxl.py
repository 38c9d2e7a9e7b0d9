"""DNGs that LibRaw cannot open come out as the same DNGs uncompressed, to the bit."""

import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile
from simulated.files import BLACK, WHITE, color_matrix, gain_map, mosaic, opcode_list, write_dng

from matcap.errors import MatcapError
from matcap.photo.jxl import plain_copy
from matcap.photo.load import load_photo

NEUTRAL = (0.5, 1.0, 0.6)
JPEG_XL = 52546
TILED = {"compression": "zlib", "tile": (32, 48), "predictor": True}


def same(found, expected):
    for name in ("pixels", "clipped", "noise"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert (found.radiometric, found.gain_map_applied) == (True, expected.gain_map_applied)


def stored(light, planes: int):
    """What a sensor's file holds, clipped somewhere."""
    bright = np.clip(2.0 * light * NEUTRAL, 0.0, 1.0)
    linear = np.rint(BLACK + bright * (WHITE - BLACK)).astype(np.uint16)
    return mosaic(bright) if planes == 1 else linear


@pytest.mark.parametrize("byteorder", ["<", ">"])
@pytest.mark.parametrize("planes", [1, 3])
def test_a_plain_copy_is_the_file_uncompressed(tmp_path, light, planes, byteorder):
    options = {
        "neutral": NEUTRAL,
        "color_matrix": color_matrix(np.array([[0.7, 0.25, 0.05], [0.2, 0.7, 0.1], [0, 0.3, 0.7]])),
        "orientation": 3,
        "opcodes2": opcode_list(gain_map(np.full((2, 2, 1), 1.5), (96, 128), planes=planes)),
        "active_area": (3, 2, 91, 120),
        "byteorder": byteorder,
    }
    samples = stored(light, planes)
    packed = write_dng(tmp_path / "packed.dng", samples, **options, **TILED)
    expected = load_photo(write_dng(tmp_path / "plain.dng", samples, **options))
    with plain_copy(packed) as copy:
        same(load_photo(copy), expected)
    assert not copy.exists() and expected.gain_map_applied and expected.clipped.any()


def test_the_raw_picture_may_lie_beside_a_preview(tmp_path, light):
    samples = stored(light, 1)

    def write(path: Path, **options) -> Path:
        whole = write_dng(tmp_path / "tags.dng", samples)
        with tifffile.TiffFile(whole) as file:
            tags = [
                (tag.code, tag.dtype, tag.count, tag.value, True)
                for tag in file.pages.first.tags
                if tag.code >= 33000
            ]
        first = [tag for tag in tags if tag[0] in (50706, 50707, 50708, 50721, 50728, 50778)]
        rest = [tag for tag in tags if tag not in first]
        with tifffile.TiffWriter(path) as out:
            preview = np.zeros((16, 24, 3), np.uint8)
            about = {"metadata": None, "software": False}
            out.write(preview, photometric="rgb", subifds=1, extratags=first, **about)
            out.write(samples, photometric=32803, extratags=rest, **about, **options)
        return path

    with plain_copy(write(tmp_path / "packed.dng", **TILED)) as copy:
        same(load_photo(copy), load_photo(write(tmp_path / "plain.dng")))


@pytest.mark.parametrize("planes", [1, 3])
def test_reads_jpeg_xl(tmp_path, light, planes):
    pytest.importorskip("imagecodecs")
    samples = stored(light, planes)
    options = {"compression": JPEG_XL, "compressionargs": {"level": 0, "lossless": True}}
    photo = load_photo(write_dng(tmp_path / "a.dng", samples, **options))
    same(photo, load_photo(write_dng(tmp_path / "b.dng", samples)))


def test_what_is_cut_off_is_named_by_its_own_name(tmp_path, light):
    path = write_dng(tmp_path / "a.dng", stored(light, 1), **TILED)
    path.write_bytes(path.read_bytes()[:-4000])
    with pytest.raises(MatcapError, match=r"a\.dng: the DNG file is truncated"), plain_copy(path):
        pass


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
