"""Orientation, field of view and flash, from whatever the tags hold."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from matcap.errors import UsageError
from matcap.photo.exif import Exif, fov_of_focal_length, read_exif
from matcap.photo.load import load_photo
from matcap.photo.orient import upright

ORIENTATION, EXIF_IFD, FOCAL_LENGTH_35, FLASH = 0x0112, 0x8769, 0xA405, 0x9209


def exif(orientation=1, focal_length=None, flash=None) -> Image.Exif:
    tags = Image.Exif()
    tags[ORIENTATION] = orientation
    if focal_length is not None:
        tags.get_ifd(EXIF_IFD)[FOCAL_LENGTH_35] = focal_length
    if flash is not None:
        tags.get_ifd(EXIF_IFD)[FLASH] = flash
    return tags


def test_field_of_view_worked_values():
    assert fov_of_focal_length(18.0) == pytest.approx(90.0)
    assert fov_of_focal_length(26.0) == pytest.approx(69.39, abs=0.01)


@pytest.mark.parametrize("form", ["jpg", "png"])
def test_field_of_view_and_flash(tmp_path, codes, form):
    path = tmp_path / f"a.{form}"
    Image.fromarray(codes).save(path, exif=exif(1, 26, 0x19))
    photo = load_photo(path)
    assert photo.fov == pytest.approx(fov_of_focal_length(26))
    assert (photo.fov_source, photo.flash_fired) == ("exif", True)
    given_fov = load_photo(path, fov=60.0)
    assert (given_fov.fov, given_fov.fov_source) == (60.0, "given")


@pytest.mark.parametrize("focal_length", [None, 0])
def test_unknown_field_of_view_is_assumed(tmp_path, codes, focal_length):
    path = tmp_path / "a.jpg"
    Image.fromarray(codes).save(path, exif=exif(1, focal_length, 0x10))
    photo = load_photo(path)
    assert (photo.fov, photo.fov_source, photo.flash_fired) == (45.0, "assumed", False)


def test_no_exif_at_all(tmp_path, codes):
    path = tmp_path / "a.jpg"
    Image.fromarray(codes).save(path)
    assert read_exif(path) == Exif()
    assert load_photo(path).flash_fired is None


@pytest.mark.parametrize("form", ["jpg", "png", "tif"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_applied_once(tmp_path, codes, form, orientation):
    """Stored so that turning it once gives the original again."""
    store = {1: 1, 2: 2, 3: 3, 4: 4, 5: 5, 6: 8, 7: 7, 8: 6}[orientation]  # the inverse turn
    path, plain = tmp_path / f"a.{form}", tmp_path / f"b.{form}"
    options = {"quality": 100, "subsampling": 0} if form == "jpg" else {}
    Image.fromarray(np.ascontiguousarray(upright(codes, store))).save(
        path, exif=exif(orientation), **options
    )
    Image.fromarray(codes).save(plain, **options)
    photo, expected = load_photo(path), load_photo(plain)
    assert photo.original_size == (128, 96) and not photo.turned
    np.testing.assert_allclose(photo.pixels, expected.pixels, atol=0.03 if form == "jpg" else 0)


@given(st.integers(1, 8))
def test_upright_agrees_with_pillow(orientation):
    from PIL import ImageOps

    picture = np.arange(6, dtype=np.uint8).reshape(2, 3)
    image = Image.fromarray(picture)
    image.getexif()[ORIENTATION] = orientation
    np.testing.assert_array_equal(
        upright(picture, orientation), np.asarray(ImageOps.exif_transpose(image))
    )


@pytest.mark.parametrize("orientation", [0, 9, 77])
def test_senseless_orientation_is_upright(tmp_path, codes, orientation):
    path = tmp_path / "a.jpg"
    Image.fromarray(codes).save(path, exif=exif(orientation))
    assert read_exif(path).orientation == 1


@settings(max_examples=30, deadline=None)  # its parser is slow on nonsense
@given(st.binary(max_size=200))
def test_broken_exif_never_raises(data):
    assert isinstance(read_exif(b"Exif\0\0" + data), Exif)
    assert isinstance(read_exif(b"II*\0\x08\0\0\0" + data), Exif)


@pytest.mark.parametrize("fov", [0.0, -45.0, 180.0, float("nan")])
def test_senseless_field_of_view_is_a_usage_error(tmp_path, codes, fov):
    path = tmp_path / "a.jpg"
    Image.fromarray(codes).save(path)
    with pytest.raises(UsageError, match="field of view"):
        load_photo(path, fov=fov)
