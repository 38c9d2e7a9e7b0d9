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
def test_8_bits_are_exact(tmp_path, codes, suffix):
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(codes).save(path)
    photo = load_photo(path)
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


def test_float_tiff_above_one_is_scaled_and_says_so(tmp_path, codes):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, (codes / codes.max() * 40).astype(np.float32), photometric="rgb")
    photo = load_photo(path)
    np.testing.assert_allclose(photo.pixels, codes / codes.max(), rtol=1e-5)
    assert "reach 40" in photo.notes[0]


def test_png_gamma_one_is_linear(tmp_path, codes):
    info = PngImagePlugin.PngInfo()
    info.add(b"gAMA", (100_000).to_bytes(4, "big"))
    Image.fromarray(codes).save(tmp_path / "a.png", pnginfo=info)
    np.testing.assert_allclose(load_photo(tmp_path / "a.png").pixels, codes / 255, rtol=1e-6)


@pytest.mark.parametrize("mode", ["L", "LA", "RGBA", "P", "1"])
def test_other_png_modes(tmp_path, codes, mode):
    image = Image.fromarray(codes).convert(mode)
    image.save(tmp_path / "a.png")
    expected = np.asarray(image.convert("RGB")) / 255
    np.testing.assert_allclose(
        load_photo(tmp_path / "a.png").pixels, srgb_decode(expected), atol=1e-6
    )


def test_transparency_does_not_darken(tmp_path, codes):
    rgba = np.dstack([codes, np.full(codes.shape[:2], 60, np.uint8)])
    Image.fromarray(rgba).save(tmp_path / "a.png")
    np.testing.assert_allclose(
        load_photo(tmp_path / "a.png").pixels, srgb_decode(codes / 255), rtol=1e-6
    )


def test_content_wins_over_the_name(tmp_path, codes):
    path = tmp_path / "a.dng"
    Image.fromarray(codes).save(path, format="JPEG")
    assert load_photo(path).pixels.shape == (96, 128, 3)


def test_grey_jpeg(tmp_path, codes):
    Image.fromarray(codes[..., 0]).save(tmp_path / "a.jpg", quality=100)
    pixels = load_photo(tmp_path / "a.jpg").pixels
    np.testing.assert_array_equal(pixels[..., 0], pixels[..., 2])


@pytest.mark.parametrize(("suffix", "level", "clipped"), [("png", 254, False), ("png", 255, True)])
def test_any_channel_at_the_limit_clips(tmp_path, codes, suffix, level, clipped):
    codes[10:20, 30:40, 1] = level
    Image.fromarray(codes).save(tmp_path / f"a.{suffix}")
    expected = np.zeros((96, 128), bool)
    expected[10:20, 30:40] = clipped
    np.testing.assert_array_equal(load_photo(tmp_path / f"a.{suffix}").clipped, expected)


@pytest.mark.parametrize(("level", "clipped"), [(253, False), (254, True)])
def test_jpeg_limit_leaves_room_for_coding(tmp_path, codes, level, clipped):
    codes[32:64, 32:64] = level
    Image.fromarray(codes).save(tmp_path / "a.jpg", quality=100, subsampling=0)
    assert (load_photo(tmp_path / "a.jpg").clipped[40:56, 40:56] == clipped).all()


def test_jpeg_clips_despite_ringing(tmp_path, codes):
    codes[16:64, 16:64] = 255
    Image.fromarray(codes).save(tmp_path / "a.jpg", quality=85)
    clipped = load_photo(tmp_path / "a.jpg").clipped
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


def test_second_picture_of_a_jpeg_is_left_alone(tmp_path, codes):
    other = Image.fromarray(255 - codes)
    Image.fromarray(codes).save(
        tmp_path / "a.jpg", format="MPO", save_all=True, append_images=[other], quality=100
    )
    photo = load_photo(tmp_path / "a.jpg")
    np.testing.assert_allclose(photo.pixels, srgb_decode(codes / 255), atol=0.05)


def test_cmyk_is_refused(tmp_path, codes):
    Image.fromarray(codes).convert("CMYK").save(tmp_path / "a.jpg")
    with pytest.raises(MatcapError, match="CMYK.*export it as RGB"):
        load_photo(tmp_path / "a.jpg")


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
