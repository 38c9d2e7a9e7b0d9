"""Orientation, field of view and flash, from whatever the tags hold."""

import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, PngImagePlugin

from matcap.errors import UsageError
from matcap.files.pixels import upright
from matcap.photo.exif import Exif, fov_of_film, phone_fov, read_exif
from matcap.photo.load import load_photo

ORIENTATION, EXIF_IFD, FOCAL_LENGTH_35, FLASH = 0x0112, 0x8769, 0xA405, 0x9209


def exif(orientation=1, focal_length=None, flash=None) -> Image.Exif:
    tags = Image.Exif()
    tags[ORIENTATION] = orientation
    if focal_length is not None:
        tags.get_ifd(EXIF_IFD)[FOCAL_LENGTH_35] = focal_length
    if flash is not None:
        tags.get_ifd(EXIF_IFD)[FLASH] = flash
    return tags


@pytest.mark.parametrize(
    ("focal_length", "size", "degrees"),
    [
        (18, (3, 2), 90.0),
        (26, (3, 2), 69.39),
        (26, (4, 3), 67.3),
        (18, (1, 1), 80.7),
        (26, (1, 1), 60.9),
        (26, (9, 16), 71.9),
    ],
)
def test_focal_lengths_on_film_refer_to_the_diagonal(focal_length, size, degrees):
    """43.27 mm (CIPA DCG-001): a square sees less across than 3:2 with the same diagonal."""
    assert fov_of_film(focal_length, *size) == pytest.approx(degrees, abs=0.06)


@pytest.mark.parametrize("form", ["jpg", "png"])
def test_field_of_view_and_flash(photo_of, codes, form):
    tags = exif(1, 26, 0x19)
    photo, given = (photo_of(codes, f"a.{form}", fov=fov, exif=tags) for fov in (None, 60.0))
    assert photo.fov == pytest.approx(fov_of_film(26, 4, 3))
    assert (photo.fov_source, photo.flash_fired) == ("exif", True)
    assert (given.fov, given.fov_source) == (60.0, "given")


@pytest.mark.parametrize("focal_length", [None, 0])
def test_unknown_field_of_view_is_assumed(photo_of, codes, focal_length):
    photo = photo_of(codes, "a.jpg", exif=exif(1, focal_length, 0x10))
    assert (photo.fov_source, photo.flash_fired) == ("assumed", False)
    assert photo.fov == pytest.approx(66.0)


def focal_plane(length=4.0, per_unit=1000.0, unit=3, film=None, pixels=None):
    tags = exif(focal_length=film)
    inside = tags.get_ifd(EXIF_IFD)
    inside |= {0x920A: length, 0xA20E: per_unit, 0xA210: unit}
    if pixels:
        inside |= {0xA002: pixels[0], 0xA003: pixels[1]}
    return tags


@pytest.mark.parametrize(
    ("tags", "half", "says"),
    [
        # 128 pixels at 100 a millimetre are 1.28 mm, seen from so many millimetres.
        ({"length": 0.64}, 1.0, False),
        ({"length": 0.64, "per_unit": 2540.0, "unit": 2}, 1.0, False),
        # Of the size that the camera gave it, whatever the file has been shrunk to.
        ({"length": 2.56, "pixels": (512, 384)}, 1.0, False),
        # Near enough to the focal length on film, it goes before that.
        ({"length": 0.7, "film": 17}, 0.64 / 0.7, True),
        ({"length": 0.7, "film": 19}, 0.64 / 0.7, False),
        # A unit gone wrong is no field of view.
        ({"length": 0.64, "unit": 2, "film": 26}, 0.8 * 43.2666 / 2 / 26, True),
        ({"length": 64.0, "unit": 4, "film": 26}, 0.8 * 43.2666 / 2 / 26, False),
    ],
    ids=str,
)
def test_focal_plane_resolution_overrides_the_35_mm_focal_length(photo_of, codes, tags, half, says):
    photo = photo_of(codes, "a.jpg", exif=focal_plane(**tags))
    assert np.tan(np.radians(photo.fov / 2)) == pytest.approx(half, rel=1e-3)
    assert [f"{photo.fov:.1f} taken" in note for note in photo.notes] == ([True] if says else [])


XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-'
    'syntax-ns#"><rdf:Description xmlns:tiff="http://ns.adobe.com/tiff/1.0/" xmlns:exif="http://ns.'
    'adobe.com/exif/1.0/" {}</rdf:RDF></x:xmpmeta>'
)
AS_ATTRIBUTES = XMP.format('tiff:Orientation="3" exif:FocalLengthIn35mmFilm="26"/>')
AS_ELEMENTS = XMP.format(
    "><tiff:Orientation>3</tiff:Orientation><exif:FocalLengthIn35mmFilm>26</exif:FocalLengthIn35mm"
    "Film></rdf:Description>"
)


def save_with_xmp(path: Path, codes, xmp: str, **options) -> None:
    image = Image.fromarray(codes)
    if path.suffix == ".png":
        text = PngImagePlugin.PngInfo()
        text.add_itxt("XML:com.adobe.xmp", xmp, zip="3" not in path.stem)
        image.save(path, pnginfo=text, **options)
    elif path.suffix == ".tif":
        image.save(path, tiffinfo={700: xmp.encode()})
    else:
        image.save(path, xmp=xmp.encode(), **options)


def test_a_shape_cut_from_a_phones_picture_keeps_its_distance():
    """A whole 4:3 picture, its square middle and its 16:9 strip, from one distance."""
    reach = np.tan(np.radians([phone_fov(*size) / 2.0 for size in [(4, 3), (3, 3), (16, 9)]]))
    np.testing.assert_allclose(reach / reach[0], [1.0, 0.75, 1.0])
    assert phone_fov(3, 4) == phone_fov(4, 3) == pytest.approx(66.0)


@pytest.mark.parametrize("xmp", [AS_ATTRIBUTES, AS_ELEMENTS], ids=["attributes", "elements"])
@pytest.mark.parametrize("form", ["jpg", "png", "tif", "webp"])
def test_orientation_in_xmp_is_applied(tmp_path, codes, form, xmp):
    options = {"lossless": True} if form == "webp" else {}
    save_with_xmp(tmp_path / f"a.{form}", codes, xmp, **options)
    Image.fromarray(codes).save(tmp_path / f"b.{form}", **options)
    photo, plain = (load_photo(tmp_path / f"{name}.{form}") for name in "ab")
    np.testing.assert_array_equal(photo.pixels, plain.pixels[::-1, ::-1])
    assert photo.fov == pytest.approx(fov_of_film(26, 4, 3)) and plain.fov == pytest.approx(66.0)


def test_exif_orientation_overrides_xmp(tmp_path, codes):
    save_with_xmp(tmp_path / "a.jpg", codes, AS_ATTRIBUTES, exif=exif(1, 30))
    found = read_exif(tmp_path / "a.jpg")
    assert (found.orientation, found.film_focal_length) == (1, 30)


def test_a_file_without_exif_is_read(tmp_path, codes):
    path = tmp_path / "a.jpg"
    Image.fromarray(codes).save(path)
    assert read_exif(path) == Exif() and load_photo(path).flash_fired is None


@pytest.mark.parametrize("form", ["jpg", "png", "tif"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_applied_once(photo_of, codes, form, orientation):
    """Stored so that turning it once gives the original again."""
    store = {1: 1, 2: 2, 3: 3, 4: 4, 5: 5, 6: 8, 7: 7, 8: 6}[orientation]  # the inverse turn
    options = {"quality": 100, "subsampling": 0} if form == "jpg" else {}
    turned = np.ascontiguousarray(upright(codes, store))
    photo = photo_of(turned, f"a.{form}", exif=exif(orientation), **options)
    expected = photo_of(codes, f"b.{form}", **options)
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


@settings(max_examples=8, deadline=None)  # its parser is slow on nonsense
@given(st.binary(max_size=200))
def test_broken_exif_never_raises(data):
    assert isinstance(read_exif(b"Exif\0\0" + data), Exif)
    assert isinstance(read_exif(b"II*\0\x08\0\0\0" + data), Exif)


@pytest.mark.parametrize("fov", [0.0, -45.0, 180.0, float("nan")])
def test_senseless_field_of_view_is_a_usage_error(photo_of, codes, fov):
    with pytest.raises(UsageError, match="field of view"):
        photo_of(codes, "a.jpg", fov=fov)


def segment(marker: int, data: bytes) -> bytes:
    return bytes((0xFF, marker)) + struct.pack(">H", len(data) + 2) + data


@pytest.mark.parametrize(
    "before",
    [
        [segment(0xE1, b"http://ns.adobe.com/xmp/extension/\0" + bytes(60_000))] * 3,
        [segment(0xEB, b"JP\0\1" + bytes(60_000))] * 4,
        [segment(0xFE, b"Exif of another: Exif\0\0"), b"\xff", segment(0xE2, b"MPF\0" + bytes(90))],
    ],
    ids=["XMP extension", "C2PA", "comment, fill byte, MPF"],
)
def test_exif_behind_other_segments(tmp_path, codes, before):
    path = tmp_path / "a.jpg"
    Image.fromarray(codes).save(path, exif=exif(orientation=6, focal_length=28, flash=1))
    data = path.read_bytes()
    path.write_bytes(data[:2] + b"".join(before) + data[2:])
    found = read_exif(path)
    assert found.orientation == 6 and found.film_focal_length == 28.0 and found.flash_fired is True


def test_a_file_without_exif_prints_nothing(tmp_path):
    path = tmp_path / "plain.jpg"
    Image.new("RGB", (8, 8)).save(path)
    code = "import pathlib, sys; from matcap.photo.exif import read_exif"
    code += "; read_exif(pathlib.Path(sys.argv[1]))"
    command = [sys.executable, "-c", code, str(path)]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (run.stdout, run.stderr) == ("", "")
