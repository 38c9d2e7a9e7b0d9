"""JPEG, PNG, TIFF, HEIC: exact where the format is, marked where it clips, linear light out."""

import sys

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image, PngImagePlugin

from matcap.errors import MatcapError
from matcap.files.srgb import srgb_decode
from matcap.photo.load import load_photo


@pytest.fixture
def deep(codes) -> np.ndarray:
    """(96, 128, 3) uint16 whose low bytes matter."""
    noise = np.random.default_rng(1).integers(0, 256, codes.shape)
    return (codes.astype(np.uint16) * 256 + noise).astype(np.uint16)


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_8_bits_are_exact(photo_of, codes, suffix):
    photo = photo_of(codes, f"a.{suffix}")
    np.testing.assert_allclose(photo.pixels, srgb_decode(codes / 255), rtol=1e-6)
    assert not photo.radiometric and photo.original_size == (128, 96)


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_16_bits_are_exact(tmp_path, deep, suffix):
    path = tmp_path / f"a.{suffix}"
    assert cv2.imwrite(str(path), deep[..., ::-1])  # OpenCV's TIFF is LZW-compressed
    np.testing.assert_allclose(load_photo(path).pixels, srgb_decode(deep / 65535), rtol=1e-6)


@pytest.mark.parametrize(
    "options",
    [
        {"tile": (32, 32)},
        {"compression": "zlib", "predictor": True},
        {"planarconfig": "separate"},
        {"bigtiff": True},
        {"byteorder": ">"},
    ],
    ids=lambda options: next(iter(options)),
)
def test_kinds_of_tiff(tmp_path, deep, options):
    path = tmp_path / "a.tif"
    stored = np.moveaxis(deep, -1, 0) if "planarconfig" in options else deep
    tifffile.imwrite(path, stored, photometric="rgb", **options)
    np.testing.assert_allclose(load_photo(path).pixels, srgb_decode(deep / 65535), rtol=1e-6)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_float_tiff_is_linear(tmp_path, codes, dtype):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, (codes / 255).astype(dtype), photometric="rgb")
    photo = load_photo(path)
    np.testing.assert_allclose(photo.pixels, codes / 255, rtol=1e-3)
    assert not photo.clipped.any() and not photo.radiometric


def test_png_gamma_one_is_linear(photo_of, codes):
    info = PngImagePlugin.PngInfo()
    info.add(b"gAMA", (100_000).to_bytes(4, "big"))
    photo = photo_of(codes, "a.png", pnginfo=info)
    np.testing.assert_allclose(photo.pixels, codes / 255, rtol=1e-6)


@pytest.mark.parametrize("mode", ["L", "LA", "RGBA", "P", "1"])
def test_other_png_modes(photo_of, codes, mode):
    image = Image.fromarray(codes).convert(mode)
    expected = srgb_decode(np.asarray(image.convert("RGB")) / 255)
    np.testing.assert_allclose(photo_of(image, "a.png").pixels, expected, atol=1e-6)


def test_transparency_does_not_darken(photo_of, codes):
    photo = photo_of(np.dstack([codes, np.full(codes.shape[:2], 60, np.uint8)]), "a.png")
    np.testing.assert_allclose(photo.pixels, srgb_decode(codes / 255), rtol=1e-6)
    assert photo.left_out is None and "equally transparent" in photo.notes[0]


@pytest.mark.parametrize("form", ["png", "tif", "webp"])
def test_a_cut_out_photograph_s_transparency_is_a_mask(photo_of, codes, form):
    """What is transparent is left out, and its colours, any at all, show nowhere."""
    alpha = np.full(codes.shape[:2], 255, np.uint8)
    alpha[:, :40], alpha[:, 40:44] = 0, 100
    painted = codes.copy()
    painted[alpha == 0] = (255, 0, 255)
    options = {"lossless": True, "exact": True} if form == "webp" else {}
    picture = np.dstack([painted, alpha])
    photo = photo_of(picture, f"a.{form}", **options)
    np.testing.assert_array_equal(photo.left_out, alpha < 128)
    kept = ~photo.left_out
    np.testing.assert_allclose(photo.pixels[kept], srgb_decode(codes / 255)[kept], rtol=1e-6)
    assert photo.pixels.max() < 0.9 and "left out" in photo.notes[0]
    shrunk = photo_of(picture, f"a.{form}", long_side=64, **options)
    np.testing.assert_array_equal(shrunk.left_out, np.indices((48, 64))[1] < 22)


def test_opaque_alpha_is_ignored_and_almost_nothing_opaque_is_refused(photo_of, codes):
    alpha = np.full(codes.shape[:2], 255, np.uint8)
    photo = photo_of(np.dstack([codes, alpha]), "a.png")
    assert photo.left_out is None and photo.notes == ()
    alpha[:, 3:] = 0
    with pytest.raises(MatcapError, match="its transparency leaves 2.3 %"):
        photo_of(np.dstack([codes, alpha]), "b.png")


def test_content_wins_over_the_name(photo_of, codes):
    assert photo_of(codes, "a.dng", format="JPEG").pixels.shape == (96, 128, 3)


def test_grey_jpeg(photo_of, codes):
    pixels = photo_of(codes[..., 0], "a.jpg", quality=100).pixels
    np.testing.assert_array_equal(pixels[..., 0], pixels[..., 2])


@pytest.mark.parametrize(("suffix", "level", "clipped"), [("png", 254, False), ("png", 255, True)])
def test_any_channel_at_the_limit_clips(photo_of, codes, suffix, level, clipped):
    codes[10:20, 30:40, 1] = level
    expected = np.zeros((96, 128), bool)
    expected[10:20, 30:40] = clipped
    np.testing.assert_array_equal(photo_of(codes, f"a.{suffix}").clipped, expected)


@pytest.mark.parametrize(("level", "clipped"), [(253, False), (254, True)])
def test_jpeg_limit_leaves_room_for_coding(photo_of, codes, level, clipped):
    codes[32:64, 32:64] = level
    photo = photo_of(codes, "a.jpg", quality=100, subsampling=0)
    assert (photo.clipped[40:56, 40:56] == clipped).all()


def test_jpeg_clips_despite_ringing(photo_of, codes):
    codes[16:64, 16:64] = 255
    clipped = photo_of(codes, "a.jpg", quality=85).clipped
    assert clipped[17:63, 17:63].mean() > 0.97
    assert not clipped[:, 80:].any()


@pytest.mark.parametrize("mark", [b"http://ns.adobe.com/hdr-gain-map/1.0/", b"aux:hdrgainmap"])
def test_hdr_gain_map_is_reported_not_applied(tmp_path, codes, mark):
    plain, marked = tmp_path / "a.jpg", tmp_path / "b.jpg"
    Image.fromarray(codes).save(plain)
    data = plain.read_bytes()
    xmp = b"http://ns.adobe.com/xap/1.0/\0<x xmlns:hdrgm='" + mark + b"'/>"
    segment = b"\xff\xe1" + (len(xmp) + 2).to_bytes(2, "big") + xmp
    marked.write_bytes(data[:2] + segment + data[2:])
    photo = load_photo(marked)
    np.testing.assert_array_equal(photo.pixels, load_photo(plain).pixels)
    assert any("gain map" in note for note in photo.notes)
    assert load_photo(plain).notes == ()


def test_second_picture_of_a_jpeg_is_left_alone(photo_of, codes):
    other = Image.fromarray(255 - codes)
    options = {"format": "MPO", "save_all": True, "append_images": [other], "quality": 100}
    photo = photo_of(codes, "a.jpg", **options)
    np.testing.assert_allclose(photo.pixels, srgb_decode(codes / 255), atol=0.05)


@pytest.mark.parametrize("form", ["webp", "avif"])
def test_webp_and_avif(photo_of, codes, form):
    turned, seen = Image.Exif(), Image.Exif()
    turned[0x0112] = 3  # which Pillow stores in AVIF as the container's own rotation
    seen.get_ifd(0x8769)[0xA405] = 26
    options = {"lossless": True} if form == "webp" else {"quality": 100, "subsampling": "4:4:4"}
    photo = photo_of(codes, f"a.{form}", exif=turned, **options)
    expected = srgb_decode(codes / 255)[::-1, ::-1]
    np.testing.assert_allclose(photo.pixels, expected, atol=1e-6 if form == "webp" else 0.03)
    assert photo.notes == ()
    other = photo_of(codes, f"b.{form}", exif=seen.tobytes(), **options)
    assert other.fov_source == "exif"


def test_a_pillow_without_avif_is_named_in_the_error(tmp_path, codes, monkeypatch):
    Image.fromarray(codes).save(tmp_path / "a.avif")
    monkeypatch.setitem(sys.modules, "PIL.AvifImagePlugin", None)
    with pytest.raises(MatcapError, match="AVIF by the Pillow that is installed is not supported"):
        load_photo(tmp_path / "a.avif")


def test_a_thumbnail_before_the_picture_is_passed_over(tmp_path, codes):
    """A first page that says so, and one that only is smaller; masks are none either."""
    for options in ({"subfiletype": 1}, {}):
        with tifffile.TiffWriter(tmp_path / "a.tif") as file:
            file.write(255 - codes[:70, :80], photometric="rgb", **options)
            file.write(codes, photometric="rgb")
            file.write(np.zeros((200, 200), np.uint8), subfiletype=1)
        with tifffile.TiffFile(tmp_path / "a.tif", mode="r+") as file:
            file.pages[2].tags["NewSubfileType"].overwrite(4)
        photo = load_photo(tmp_path / "a.tif")
        np.testing.assert_allclose(photo.pixels, srgb_decode(codes / 255), rtol=1e-6)
        assert photo.notes == ()


def test_of_several_pictures_the_first_is_read_with_a_note(tmp_path, codes):
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for page in (codes, 255 - codes):
            file.write(page, photometric="rgb")
    photo = load_photo(tmp_path / "a.tif")
    np.testing.assert_allclose(photo.pixels, srgb_decode(codes / 255), rtol=1e-6)
    assert photo.notes == ("The file holds 2 pictures: the first is read.",)


def test_a_larger_picture_in_a_sub_directory_is_refused(tmp_path, codes):
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(codes[:64, :64], photometric="rgb", subifds=1)
        file.write(codes, photometric="rgb")
    with pytest.raises(MatcapError, match="sub-directory.* is not supported"):
        load_photo(tmp_path / "a.tif")


@pytest.mark.parametrize("form", ["jpg", "tif"])
def test_inks_are_refused(photo_of, codes, form):
    inks = Image.fromarray(np.dstack([255 - codes, np.zeros(codes.shape[:2], np.uint8)]), "CMYK")
    with pytest.raises(MatcapError, match="CMYK.* is not supported"):
        photo_of(inks, f"a.{form}")


@pytest.mark.parametrize("kind", ["cielab", "icclab"])
def test_cielab_is_refused(tmp_path, codes, kind):
    tifffile.imwrite(tmp_path / "a.tif", codes, photometric=kind)
    with pytest.raises(MatcapError, match="LAB colours is not supported"):
        load_photo(tmp_path / "a.tif")


def test_heic(tmp_path, codes):
    pillow_heif = pytest.importorskip("pillow_heif")
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 26
    heif = pillow_heif.from_pillow(Image.fromarray(codes))
    heif.save(tmp_path / "a.heic", quality=95, chroma=444, exif=exif.tobytes())
    photo = load_photo(tmp_path / "a.heic")
    np.testing.assert_allclose(photo.pixels, srgb_decode(codes / 255), atol=0.05)
    assert photo.fov_source == "exif"


def test_heic_without_its_extra_names_the_command(tmp_path, monkeypatch):
    (tmp_path / "a.heic").write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(100))
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    with pytest.raises(MatcapError, match=r'pip install "matcap\[heic\]"') as caught:
        load_photo(tmp_path / "a.heic")
    assert isinstance(caught.value.__cause__, ImportError)
