import dataclasses
import filecmp
import struct

import exifread
import numpy as np
import pytest
import rawpy
import tifffile
from PIL import Image

from matcap.errors import MatcapError
from matcap.flash.geometry import FlashSetup
from matcap.photo.load import load_photo
from matcap_lab.simulate.files import gain_map, write_dng, write_jpeg
from matcap_lab.simulate.photograph import PhoneCamera, Shot, expose

CAMERA = PhoneCamera(width=240, height=180)


@pytest.fixture
def shot():
    """Smooth and colourful, so that demosaicing is nearly exact and mixed-up channels show."""
    y, x = np.mgrid[0:180, 0:240] / 240
    linear = np.stack([0.15 + 0.4 * x, 0.12 + 0.4 * y, 0.08 + 0.2 * (x + y)], axis=-1)
    return Shot(linear, FlashSetup(fov=CAMERA.fov), CAMERA)


def _develop(path):
    with rawpy.imread(str(path)) as raw:
        return (
            raw.postprocess(
                gamma=(1, 1),
                no_auto_bright=True,
                output_bps=16,
                use_camera_wb=True,
                adjust_maximum_thr=0,
            )
            / 65535.0
        )


def _write(path, shot, seed):
    write = write_dng if path.suffix == ".dng" else write_jpeg
    write(path, shot, seed)
    return path


def test_dng_develops_to_the_truth_within_noise(shot, tmp_path):
    write_dng(tmp_path / "a.dng", shot, seed=1)
    error = (_develop(tmp_path / "a.dng") - shot.linear)[4:-4, 4:-4]
    # Without bias, and no noisier than a sensor of this well: the matrix amplifies red and blue.
    np.testing.assert_allclose(error.mean((0, 1)), 0.0, atol=5e-4)
    assert error.std() < 3.0 * np.sqrt(shot.linear.mean() / CAMERA.full_well)


def test_dng_clips_white(tmp_path):
    white = Shot(np.full((180, 240, 3), 3.0), FlashSetup(), CAMERA)
    write_dng(tmp_path / "a.dng", white, seed=1)
    np.testing.assert_allclose(_develop(tmp_path / "a.dng"), 1.0, atol=2e-3)


@pytest.mark.parametrize("suffix", ["dng", "jpg"])
def test_exif_is_readable(shot, tmp_path, suffix):
    path = _write(tmp_path / f"a.{suffix}", shot, 1)
    with path.open("rb") as stream:
        tags = exifread.process_file(stream, details=False)
    # 28 mm across the long side of 36 are 27 by the diagonal of 4:3.
    assert tags["EXIF FocalLengthIn35mmFilm"].values == [27]
    assert load_photo(path).fov == pytest.approx(CAMERA.fov, abs=1e-3)
    assert tags["EXIF Flash"].values[0] & 1
    assert tags["Image Orientation"].values == [1]
    assert str(tags["Image Make"]) == "matcap"
    assert float(tags["EXIF ExposureTime"].values[0]) == pytest.approx(1 / 60)


def test_gain_map_undoes_the_shading(shot, tmp_path):
    grey = dataclasses.replace(shot, linear=np.full((180, 240, 3), 0.3))
    write_dng(tmp_path / "a.dng", grey, seed=1, shading=0.5)
    developed = _develop(tmp_path / "a.dng")
    assert developed[:20, :20].mean() / developed[80:100, 110:130].mean() < 0.65
    with tifffile.TiffFile(tmp_path / "a.dng") as tiff:
        opcodes = tiff.pages.first.tags[51009].value
    assert struct.unpack(">L", opcodes[:4]) == (4,)
    number, _, _, size = struct.unpack(">L4sLL", opcodes[4:20])
    assert number == 9
    head = struct.unpack(">10L4dL", opcodes[20 : 20 + 40 + 32 + 4])
    assert head[:10] == (0, 0, 180, 240, 0, 1, 2, 2, 13, 17)
    gains = np.frombuffer(opcodes[20 + 76 : 20 + size], ">f4").reshape(13, 17)
    np.testing.assert_array_equal(gains, gain_map(0.5))
    # Nearest of 13 x 17 points is enough to flatten the picture to a few per cent.
    rows = np.round((np.arange(180) + 0.5) / 180 * 12).astype(int)
    columns = np.round((np.arange(240) + 0.5) / 240 * 16).astype(int)
    flat = developed.mean(-1) * gains[rows[:, None], columns]
    blocks = flat.reshape(6, 30, 6, 40).mean((1, 3))
    np.testing.assert_allclose(blocks, 0.3, rtol=0.03)


def test_dng_without_shading_has_no_opcodes(shot, tmp_path):
    write_dng(tmp_path / "a.dng", shot, seed=1)
    with tifffile.TiffFile(tmp_path / "a.dng") as tiff:
        assert 51009 not in tiff.pages.first.tags


@pytest.mark.parametrize("suffix", ["dng", "jpg"])
def test_files_are_reproducible(shot, tmp_path, suffix):
    files = [_write(tmp_path / f"{name}.{suffix}", shot, 5) for name in ("a", "b")]
    assert filecmp.cmp(*files, shallow=False)


def test_jpeg_shows_the_exposed_picture(shot, tmp_path):
    write_jpeg(tmp_path / "a.jpg", shot, seed=1)
    with Image.open(tmp_path / "a.jpg") as picture:
        code = np.asarray(picture, dtype=np.float64) / 255.0
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    assert np.abs(linear - expose(shot, 1)).mean() < 0.01
    np.testing.assert_allclose(linear.mean((0, 1)), shot.linear.mean((0, 1)), rtol=0.01)


def test_unwritable_place_is_one_sentence(shot, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(MatcapError):
        write_dng(tmp_path / "file" / "a.dng", shot, seed=1)
