"""Developed pictures, their size and refusals."""

import io
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, PngImagePlugin
from simulated.files import mosaic, write_dng

from matcap.errors import ExitCode, MatcapError, UsageError
from matcap.files.color import srgb_decode
from matcap.photo.left_out import shrink, shrunk_size
from matcap.photo.load import load_photo
from matcap.photo.photo import check_size

# JPEG, PNG, TIFF, HEIC: exact where the format is, marked where it clips, linear light out.


@pytest.fixture
def deep(codes) -> np.ndarray:
    """(96, 128, 3) uint16 whose low bytes matter."""
    noise = np.random.default_rng(1).integers(0, 256, codes.shape)
    return (codes.astype(np.uint16) * 256 + noise).astype(np.uint16)


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize("bits", [8, 16])
def test_codes_are_decoded_exactly(tmp_path, codes, deep, suffix, bits):
    path, stored = tmp_path / f"a.{suffix}", codes if bits == 8 else deep
    assert cv2.imwrite(str(path), stored[..., ::-1])  # OpenCV's TIFF is LZW-compressed
    photo = load_photo(path)
    np.testing.assert_allclose(photo.pixels, srgb_decode(stored / (2**bits - 1)), rtol=1e-6)
    assert not photo.radiometric and photo.original_size == (128, 96)


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
def test_kinds_of_tiff_are_read(tmp_path, deep, options):
    path = tmp_path / "a.tif"
    stored = np.moveaxis(deep, -1, 0) if "planarconfig" in options else deep
    tifffile.imwrite(path, stored, photometric="rgb", **options)
    np.testing.assert_allclose(load_photo(path).pixels, srgb_decode(deep / 65535), rtol=1e-6)


def test_png_gamma_one_is_linear(photo_of, codes):
    info = PngImagePlugin.PngInfo()
    info.add(b"gAMA", (100_000).to_bytes(4, "big"))
    photo = photo_of(codes, "a.png", pnginfo=info)
    np.testing.assert_allclose(photo.pixels, codes / 255, rtol=1e-6)


@pytest.mark.parametrize("mode", ["L", "LA", "RGBA", "P", "1"])
def test_other_png_modes_are_read(photo_of, codes, mode):
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


def test_content_overrides_the_suffix(photo_of, codes):
    assert photo_of(codes, "a.dng", format="JPEG").pixels.shape == (96, 128, 3)


def test_a_grey_jpeg_is_read(photo_of, codes):
    pixels = photo_of(codes[..., 0], "a.jpg", quality=100).pixels
    np.testing.assert_array_equal(pixels[..., 0], pixels[..., 2])


@pytest.mark.parametrize(
    ("suffix", "level", "clipped"),
    [("png", 254, False), ("png", 255, True), ("jpg", 253, False), ("jpg", 254, True)],
)
def test_any_channel_at_the_limit_clips(photo_of, codes, suffix, level, clipped):
    """JPEG leaves room for coding."""
    codes[32:64, 32:64, slice(1, 2) if suffix == "png" else slice(3)] = level
    options = {"quality": 100, "subsampling": 0} if suffix == "jpg" else {}
    photo = photo_of(codes, f"a.{suffix}", **options)
    assert (photo.clipped[40:56, 40:56] == clipped).all() and not photo.clipped[:, 80:].any()


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
    assert any("gain map" in note for note in photo.notes) and load_photo(plain).notes == ()


@pytest.mark.parametrize("suffix", ["avif", "webp"])
def test_a_gain_map_that_decoders_keep_is_named_with_what_helps(tmp_path, codes, suffix):
    xmp = b"<x xmlns:hdrgm='http://ns.adobe.com/hdr-gain-map/1.0/'/>"
    Image.fromarray(codes).save(tmp_path / f"a.{suffix}", xmp=xmp)
    (note,) = (note for note in load_photo(tmp_path / f"a.{suffix}").notes if "gain map" in note)
    assert "do not return it; export it as a JPEG" in note and "darker photograph" in note


def test_second_picture_of_a_jpeg_is_left_alone(photo_of, codes):
    other = Image.fromarray(255 - codes)
    options = {"format": "MPO", "save_all": True, "append_images": [other], "quality": 100}
    photo = photo_of(codes, "a.jpg", **options)
    np.testing.assert_allclose(photo.pixels, srgb_decode(codes / 255), atol=0.05)


@pytest.mark.parametrize("form", ["webp", "avif"])
def test_webp_and_avif_are_read(photo_of, codes, form):
    turned, seen = Image.Exif(), Image.Exif()
    turned[0x0112] = 3  # which Pillow stores in AVIF as the container's own rotation
    seen.get_ifd(0x8769)[0xA405] = 26
    options = {"lossless": True} if form == "webp" else {"quality": 100, "subsampling": "4:4:4"}
    photo = photo_of(codes, f"a.{form}", exif=turned, **options)
    expected = srgb_decode(codes / 255)[::-1, ::-1]
    np.testing.assert_allclose(photo.pixels, expected, atol=1e-6 if form == "webp" else 0.03)
    assert photo.notes == ()
    assert photo_of(codes, f"b.{form}", exif=seen.tobytes(), **options).fov_source == "exif"


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


def test_heic_is_read(tmp_path, codes):
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


# Downsampling: area means of light, never enlarged, in little memory.


def reader(pixels, mask):
    return lambda top, bottom: (pixels[top:bottom], mask[top:bottom])


def area_matrix(size: int, new: int) -> np.ndarray:
    """(new, size): what share of each new pixel each old one covers."""
    edges = np.linspace(0, size, new + 1)
    old = np.arange(size)
    overlap = np.minimum(edges[1:, None], old + 1) - np.maximum(edges[:-1, None], old)
    return np.maximum(overlap, 0.0) * new / size


@settings(max_examples=30, deadline=None)
@given(st.integers(64, 200), st.integers(64, 200), st.integers(16, 199), st.integers(0, 999))
def test_a_smaller_picture_is_the_area_mean(width, height, long_side, seed):
    rng = np.random.default_rng(seed)
    pixels = rng.random((height, width, 3)).astype(np.float32)
    mask = rng.random((height, width)) < 0.3
    small, _ = shrink(reader(pixels, mask), width, height, long_side)
    new_width, new_height = shrunk_size(width, height, long_side)
    assert small.shape == (new_height, new_width, 3)
    down, across = area_matrix(height, new_height), area_matrix(width, new_width)
    expected = np.einsum("ah,hwc,bw->abc", down, pixels, across, optimize=True)
    np.testing.assert_allclose(small, expected, atol=2e-5)


def test_reading_by_strips_leaves_no_borders(monkeypatch):
    pixels = np.random.default_rng(0).random((150, 200, 3)).astype(np.float32)
    mask = pixels[..., 0] > 0.8
    whole = shrink(reader(pixels, mask), 200, 150, 77)
    monkeypatch.setattr("matcap.photo.left_out._STRIP_PIXELS", 1400)
    for one, other in zip(whole, shrink(reader(pixels, mask), 200, 150, 77), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(("sites", "clipped"), [(3, False), (4, True)])
def test_a_quarter_of_the_area_clips(sites, clipped):
    mask = np.zeros((128, 128), bool)
    for site in range(sites):
        mask[site // 4 :: 4, site % 4 :: 4] = True
    pixels = np.ones((128, 128, 3), np.float32)
    assert (shrink(reader(pixels, mask), 128, 128, 32)[1] == clipped).all()


@given(st.integers(1, 4000), st.integers(1, 4000), st.integers(1, 5000))
def test_size_never_grows_and_keeps_its_shape(width, height, long_side):
    new_width, new_height = shrunk_size(width, height, long_side)
    assert 1 <= new_width <= width and 1 <= new_height <= height
    assert max(new_width, new_height) == min(long_side, max(width, height))


def test_portrait_is_turned_anticlockwise(photo_of, codes):
    portrait = np.ascontiguousarray(codes.swapaxes(0, 1))
    photo = photo_of(portrait, "a.png", long_side=64)
    assert photo.turned and photo.original_size == (96, 128)
    assert photo.pixels.shape == (48, 64, 3) and photo.clipped.shape == (48, 64)
    whole = photo_of(portrait, "a.png").pixels
    # Anticlockwise: the top right corner goes to the top left.
    np.testing.assert_allclose(whole[0, 0], srgb_decode(portrait[0, -1] / 255), rtol=1e-5)
    np.testing.assert_allclose(whole[-1, 0], srgb_decode(portrait[0, 0] / 255), rtol=1e-5)


@pytest.mark.parametrize("long_side", [0, -5, 63])
def test_too_short_a_long_side_is_a_usage_error(long_side):
    with pytest.raises(UsageError, match="long side"):
        load_photo("a.png", long_side=long_side)


# The high-water mark is the kernel's, of the child alone: C libraries do not tell tracemalloc.
SCRIPT = """
import sys
from matcap.photo.load import load_photo

def mebibytes(field):
    lines = open("/proc/self/status").read().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(field))

import cv2, exifread, PIL.Image
before = mebibytes("VmRSS")
photo = load_photo(sys.argv[1], long_side=int(sys.argv[2]))
assert photo.original_size == (int(sys.argv[3]), int(sys.argv[4])), photo.original_size
assert abs(float(photo.pixels.mean()) - float(sys.argv[5])) < 2e-3
print(mebibytes("VmHWM") - before)
"""


MEAN = float(srgb_decode(np.linspace(0.0, 1.0, 256)).mean())  # of a ramp from black to white


def test_50_megapixels_take_little_more_than_their_pixels(tmp_path):
    path = tmp_path / "large.jpg"
    gradient = Image.linear_gradient("L").resize((8000, 6250))
    Image.merge("RGB", (gradient,) * 3).save(path, quality=80)
    del gradient
    assert taken(path, 1024, (8000, 6250), MEAN) < 3 * (8000 * 6250 * 3 / 2**20)


def test_large_jpegs_are_shrunk_while_they_are_decoded(photo_of, codes, monkeypatch):
    """200 megapixels of today's phones would take 2 GB."""
    expected = photo_of(codes, "a.jpg", long_side=64).pixels
    monkeypatch.setattr("matcap.files.pixels._LARGE", 1000)
    photo = photo_of(codes, "a.jpg", long_side=64)
    assert photo.original_size == (128, 96)
    np.testing.assert_allclose(photo.pixels, expected, atol=0.02)


def taken(path, long_side: int, size: tuple[int, int], mean: float) -> float:
    """MiB that reading a photograph takes at most, in a process of its own."""
    asked = [str(value) for value in (path, long_side, *size, mean)]
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *asked], capture_output=True, text=True, check=True
    )
    return float(done.stdout)


# Every file that cannot be used is refused in one sentence: where, what, remedy.


def refuse(path: Path) -> MatcapError:
    with pytest.raises(MatcapError) as caught:
        load_photo(path)
    error = caught.value
    assert str(error).startswith(str(path)) and "\n" not in str(error)
    assert error.remedy and error.exit_code is ExitCode.NOTHING_SUCCEEDED
    return error


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "empty"),
        (b"Dear diary, today I photographed a wall.\n" * 30, "text file"),
        (b"%PDF-1.7\n\x80\x81" + bytes(2000), "a PDF document"),
        (b"\0\0\0\x20ftypisom" + bytes(2000), "a video"),
        (b"PK\x03\x04\0\0" + bytes(2000), "not a photograph"),
        (bytes(100_000), "not a photograph"),
        (b"II*\0\x08\0\0\0", "damaged"),
        (b"\xff\x0a" + bytes(100), "JPEG XL"),
        (b"GIF89a" + bytes(100), "GIF"),
    ],
    ids=lambda one: str(one)[:20],
)
def test_other_files_are_refused_by_what_they_are(tmp_path, data, said):
    (tmp_path / "a.dng").write_bytes(data)
    assert said in refuse(tmp_path / "a.dng").what


def test_what_is_no_readable_file_is_refused(tmp_path, codes, monkeypatch):
    error = refuse(tmp_path / "none.dng")
    assert "no such file" in error.what and isinstance(error.__cause__, FileNotFoundError)
    assert "folder" in refuse(tmp_path).what
    os.mkfifo(tmp_path / "pipe.jpg")  # opening it would wait for ever
    assert "a pipe or a device" in refuse(tmp_path / "pipe.jpg").what
    path = tmp_path / "a.png"
    Image.fromarray(codes).save(path)

    def denied(*_args, **_options):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "open", denied)  # chmod would not stop a superuser
    assert "may not be read" in refuse(path).what


@pytest.mark.parametrize("suffix", ["png", "tif", "jpg", "dng"])
@pytest.mark.parametrize(
    ("shape", "value", "word"),
    [((40, 90), 128, "too small"), ((63, 500), 128, "too small"), ((500, 63), 128, "too small"),
     ((96, 128), 0, "all black"), ((96, 128), 255, "all white")],
)  # fmt: skip
def test_pictures_that_show_no_material_are_refused(tmp_path, suffix, shape, value, word):
    path, picture = tmp_path / f"a.{suffix}", np.full((*shape, 3), value, np.uint8)
    if suffix == "dng":
        write_dng(path, mosaic(picture / 127.0))
    else:
        Image.fromarray(picture).save(path)
    assert word in refuse(path).what


def test_a_header_with_an_absurd_size_is_refused(tmp_path, codes):
    """Refused before memory is asked for: 13 gigapixels in a file of a few kilobytes."""
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, codes, photometric="rgb", compression="zlib")
    with tifffile.TiffFile(path, mode="r+") as file:
        for tag in ("ImageWidth", "ImageLength", "RowsPerStrip"):
            file.pages.first.tags[tag].overwrite(60_000 if tag != "ImageWidth" else 65_000)
    refuse(path)
    with pytest.raises(MatcapError, match="more than can be read"):
        check_size(path, 60_000, 60_000)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_nan_is_refused(tmp_path, light, value):
    light[50, 60, 1] = value
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, light.astype(np.float32), photometric="rgb")
    assert "NaN or infinity" in refuse(path).what


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, bytes]:
    """A small noisy picture in every form that is read without extras."""
    folder = tmp_path_factory.mktemp("whole")
    picture = np.random.default_rng(0).integers(20, 200, (64, 80, 3)).astype(np.uint8)
    files = {}
    for name, form in [("jpg", "JPEG"), ("png", "PNG"), ("tif", "TIFF")]:
        stream = io.BytesIO()
        Image.fromarray(picture).save(stream, form)
        files[name] = stream.getvalue()
    files["dng"] = write_dng(folder / "a.dng", mosaic(picture / 255.0)).read_bytes()
    return files


@pytest.mark.parametrize("form", ["jpg", "png", "tif", "dng"])
def test_a_truncated_file_is_refused(tmp_path, whole, form, capfd):
    path = tmp_path / f"half.{form}"
    path.write_bytes(whole[form][: len(whole[form]) // 2])
    assert "truncated or damaged" in refuse(path).what
    assert capfd.readouterr() == ("", "")  # what C libraries print stays out of the terminal


def test_unsupported_files_are_not_reported_as_damaged(tmp_path, codes):
    """Whole files: a JPEG of 12 bits by its frame, lossless ones, TIFFs of rare codings."""
    Image.fromarray(codes).save(tmp_path / "a.jpg")
    data = (tmp_path / "a.jpg").read_bytes()
    frame = data.index(b"\xff\xc0")
    for marker, bits, word in ((0xC1, 12, "12 bits"), (0xC3, 8, "lossless")):
        changed = bytearray(data)
        changed[frame + 1], changed[frame + 4] = marker, bits
        (tmp_path / "b.jpg").write_bytes(changed)
        error = refuse(tmp_path / "b.jpg")
        assert word in error.what and "not supported" in error.what
    tifffile.imwrite(tmp_path / "a.tif", codes.astype(np.complex64), photometric="minisblack")
    assert "not supported" in refuse(tmp_path / "a.tif").what
    tifffile.imwrite(tmp_path / "b.tif", codes, photometric="rgb")
    with tifffile.TiffFile(tmp_path / "b.tif", mode="r+") as file:
        file.pages.first.tags["Compression"].overwrite(34925)  # LZMA
    assert "compression LZMA is not supported" in refuse(tmp_path / "b.tif").what


def test_bands_without_names_are_no_colours(tmp_path):
    bands = np.full((96, 128, 5), 100, np.uint8)
    tifffile.imwrite(tmp_path / "a.tif", bands, photometric="minisblack", planarconfig="contig")
    assert "5 bands" in refuse(tmp_path / "a.tif").what
