"""EXR files: exact values, clear refusals, the same bytes each time."""

import filecmp

import numpy as np
import OpenEXR
import pytest

from matcap.errors import MatcapError
from matcap.files.exr import REC709, read_exr, write_exr


@pytest.fixture
def picture():
    return np.random.default_rng(0).normal(size=(33, 50, 3)).astype(np.float32)


def test_float_is_exact_and_half_is_rounded_to_nearest(tmp_path, picture):
    write_exr(tmp_path / "f.exr", picture, half=False)
    write_exr(tmp_path / "h.exr", picture, half=True)
    assert np.array_equal(read_exr(tmp_path / "f.exr").pixels, picture)
    assert np.array_equal(read_exr(tmp_path / "h.exr").pixels, picture.astype(np.float16))


def test_grey_is_one_channel_y(tmp_path, picture):
    write_exr(tmp_path / "g.exr", picture[..., 0], half=False)
    channels = OpenEXR.File(str(tmp_path / "g.exr")).channels()
    assert list(channels) == ["Y"]
    assert np.array_equal(channels["Y"].pixels, picture[..., 0])


def test_another_reader_finds_types_rows_and_primaries(tmp_path, picture):
    write_exr(tmp_path / "h.exr", picture, half=True)
    file = OpenEXR.File(str(tmp_path / "h.exr"))
    assert file.channels()["RGB"].pixels.dtype == np.float16
    assert np.array_equal(file.channels()["RGB"].pixels, picture.astype(np.float16))
    assert file.header()["chromaticities"] == pytest.approx(REC709)


def test_the_same_numbers_give_the_same_file(tmp_path, picture):
    for name in ("a.exr", "b.exr"):
        write_exr(tmp_path / name, picture, half=True)
    assert filecmp.cmp(tmp_path / "a.exr", tmp_path / "b.exr", shallow=False)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_refused(tmp_path, picture, value):
    picture[3, 4, 1] = value
    with pytest.raises(MatcapError, match="not finite"):
        write_exr(tmp_path / "a.exr", picture, half=False)


def test_values_too_large_for_half_are_refused(tmp_path, picture):
    picture[3, 4, 1] = 70000.0
    with pytest.raises(MatcapError, match="too large"):
        write_exr(tmp_path / "a.exr", picture, half=True)


def test_an_unwritable_place_is_an_os_error(tmp_path, picture):
    with pytest.raises(OSError, match="No such file"):
        write_exr(tmp_path / "none" / "a.exr", picture, half=True)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.99])
def test_truncated_files_are_refused(tmp_path, picture, share, capfd):
    whole = tmp_path / "a.exr"
    write_exr(whole, picture, half=False)
    content = whole.read_bytes()
    whole.write_bytes(content[: int(share * len(content))])
    with pytest.raises(MatcapError, match="truncated or corrupt|not a readable EXR"):
        read_exr(whole)
    assert capfd.readouterr() == ("", "")


def test_other_files_are_refused(tmp_path):
    (tmp_path / "a.exr").write_text("not a picture")
    with pytest.raises(MatcapError, match="not a readable EXR"):
        read_exr(tmp_path / "a.exr")
    with pytest.raises(MatcapError, match="missing"):
        read_exr(tmp_path / "b.exr")


def test_not_finite_and_misfitting_files_are_refused_on_reading(tmp_path):
    nan = np.full((4, 4), np.nan, dtype=np.float32)
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Y": nan}).write(str(tmp_path / "a.exr"))
    with pytest.raises(MatcapError, match="not finite"):
        read_exr(tmp_path / "a.exr")
    with pytest.raises(MatcapError, match="is 4 x 4 texels, not 5 x 4"):
        read_exr(tmp_path / "a.exr", size=(5, 4))
