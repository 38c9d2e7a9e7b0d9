"""Picture files, OpenEXR and colour spaces."""

import filecmp
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageOps

import matcap
from matcap.errors import ExitCode, MatcapError
from matcap.files.color import (
    LUMINANCE,
    rec709_from,
    srgb_decode,
    srgb_encode,
    srgb_picture,
    srgb_slope,
)
from matcap.files.color import REC709 as COLOR_REC709
from matcap.files.exr import REC709, read_exr, write_exr, write_exr_channels
from matcap.files.pixels import linear_colours, read_mask, read_pixels, write_picture, write_png
from matcap.photo.load import load_photo

# Pictures for people, and masks as painting programs save them.


def read(path):
    """OpenCV's own order back to red, green, blue."""
    stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    return stored[..., ::-1] if stored.ndim == 3 else stored


@pytest.mark.parametrize("bits", [8, 16])
def test_codes_are_rounded_not_truncated(tmp_path, bits):
    most = 2**bits - 1
    codes = np.array([[0.0, 0.49, 0.51, 1.49, 1.51, most - 0.51, most - 0.49, most]])
    write_png(tmp_path / "a.png", (codes / most).astype(np.float32), bits=bits)
    assert read(tmp_path / "a.png").tolist() == [[0, 0, 1, 1, 2, most - 1, most, most]]


def test_picture_formats_by_suffix(tmp_path):
    image = np.full((4, 5, 3), 0.21404114, dtype=np.float32)
    image[0, 0] = 7.5
    write_picture(image, tmp_path / "new" / "a.exr")
    assert np.array_equal(read_exr(tmp_path / "new" / "a.exr").pixels, image)
    write_picture(image, tmp_path / "a.PNG")
    assert read(tmp_path / "a.PNG")[1, 1].tolist() == [128, 128, 128]
    assert read(tmp_path / "a.PNG")[0, 0].tolist() == [255, 255, 255]


def test_invalid_pictures_are_not_written(tmp_path):
    with pytest.raises(MatcapError, match="unknown picture format") as caught:
        write_picture(np.zeros((2, 2, 3), dtype=np.float32), tmp_path / "a.jpg")
    assert caught.value.exit_code == ExitCode.USAGE
    for name in ("a.png", "a.exr"):
        with pytest.raises(MatcapError, match="not finite"):
            write_picture(np.full((2, 2, 3), np.nan, dtype=np.float32), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


SHAPE = np.clip(np.linspace(-0.5, 1.5, 16 * 12).reshape(12, 16), 0.0, 1.0)
CODES = np.rint(255 * SHAPE).astype(np.uint8)


def saved(path, *planes):
    Image.fromarray(np.stack(planes, axis=-1) if len(planes) > 1 else planes[0]).save(path)
    return read_mask(path)


FULL, EMPTY = np.full_like(CODES, 255), np.zeros_like(CODES)


@pytest.mark.parametrize(
    "planes",
    [
        (CODES,),
        (CODES, CODES, CODES),
        (CODES, FULL),  # grey and an opaque alpha
        (CODES, CODES, CODES, FULL),
        (FULL, CODES),  # white, with the shape in alpha
        (FULL, FULL, FULL, CODES),
        (EMPTY, EMPTY, EMPTY, CODES),  # painted in black on nothing
        (FULL, EMPTY, EMPTY, CODES),  # in red
        (CODES // 2, CODES, 255 - CODES, CODES),  # a cut-out of what has colours
    ],
)
def test_grey_and_alpha_mean_the_same(tmp_path, planes):
    np.testing.assert_allclose(saved(tmp_path / "a.png", *planes), CODES / 255.0, atol=2e-3)


def test_a_painted_layer_is_seen_over_black(tmp_path):
    alpha = np.where(np.arange(16) < 8, 255, 0).astype(np.uint8) + EMPTY
    found = saved(tmp_path / "a.png", CODES, CODES, CODES, alpha)
    np.testing.assert_allclose(found, CODES / 255.0 * (alpha > 0), atol=1e-6)


def test_sixteen_bits_palettes_and_other_kinds(tmp_path):
    Image.fromarray(np.rint(65535 * SHAPE).astype(np.uint16)).save(tmp_path / "a.png")
    np.testing.assert_allclose(read_mask(tmp_path / "a.png"), SHAPE, atol=1e-5)
    black = Image.fromarray(CODES > 127)
    for name in ("b.png", "b.tif", "b.bmp"):
        black.save(tmp_path / name)
        np.testing.assert_array_equal(read_mask(tmp_path / name), CODES > 127)
    black.convert("P").save(tmp_path / "p.png", transparency=0)
    np.testing.assert_array_equal(read_mask(tmp_path / "p.png"), CODES > 127)
    tifffile.imwrite(tmp_path / "f.tif", SHAPE.astype(np.float32), photometric="minisblack")
    np.testing.assert_allclose(read_mask(tmp_path / "f.tif"), SHAPE, atol=1e-6)


def test_pictures_that_are_no_masks_are_refused(tmp_path):
    with pytest.raises(MatcapError, match="transparent"):
        saved(tmp_path / "a.png", FULL, FULL, FULL, EMPTY)
    tifffile.imwrite(tmp_path / "f.tif", 3.0 * SHAPE.astype(np.float32), photometric="minisblack")
    with pytest.raises(MatcapError, match="not from 0 to 1"):
        read_mask(tmp_path / "f.tif")
    (tmp_path / "t.png").write_text("no picture")
    with pytest.raises(MatcapError, match="not a readable picture"):
        read_mask(tmp_path / "t.png")
    with pytest.raises(MatcapError, match="there is no such file"):
        read_mask(tmp_path / "none.png")


# EXR files: exact values, clear refusals, the same bytes each time.


@pytest.fixture
def picture():
    return np.random.default_rng(0).normal(size=(33, 50, 3)).astype(np.float32)


def test_float_is_exact_and_half_is_rounded_to_nearest(tmp_path, picture):
    write_exr(tmp_path / "f.exr", picture, half=False)
    write_exr(tmp_path / "h.exr", picture, half=True)
    assert np.array_equal(read_exr(tmp_path / "f.exr").pixels, picture)
    assert np.array_equal(read_exr(tmp_path / "h.exr").pixels, picture.astype(np.float16))


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


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        (np.nan, "has values that are not finite; make the maps again."),
        (-np.inf, "has values that are not finite; make the maps again."),
        (70000.0, "has values too large for half float (65504); scale them down."),
    ],
)
def test_values_without_a_code_are_refused_in_one_sentence(tmp_path, picture, value, sentence):
    picture[3, 4, 1] = value
    for write in (
        lambda: write_exr(tmp_path / "a.exr", picture, half=True),
        lambda: write_exr_channels(tmp_path / "a.exr", {"Y": picture[..., 1]}),
    ):
        with pytest.raises(MatcapError) as refused:
            write()
        assert str(refused.value) == f"a.exr: {sentence}"
    assert not list(tmp_path.iterdir())


def test_a_missing_folder_is_an_error_of_the_system(tmp_path, picture):
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


# The one sRGB curve, colours of other primaries, and one luminance in the package.

D65 = (0.3127, 0.3290)
P3 = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *D65)
REC2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *D65)
# ITU-R BT.2087-0 gives the inverse; BT.2407-0, section 2 this.
REC2020_TO_709 = [
    [1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187],
]  # fmt: skip


def test_rec2020_as_published():
    np.testing.assert_allclose(rec709_from(REC2020), REC2020_TO_709, atol=2e-4)


def test_rec709_itself_and_what_rounding_makes_of_it_need_no_matrix():
    assert rec709_from(COLOR_REC709) is None
    assert rec709_from(np.round(np.array(COLOR_REC709) + 4e-5, 4)) is None
    assert rec709_from(P3) is not None


def test_tristimulus_values_are_relative_to_d65():
    matrix = rec709_from((1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3))
    np.testing.assert_allclose(matrix @ [0.9505, 1.0, 1.0890], 1.0, atol=1e-3)
    # IEC 61966-2-1, annex F.
    np.testing.assert_allclose(matrix[0], [3.2406, -1.5372, -0.4986], atol=2e-3)


def test_luminance_is_the_second_row_of_the_way_to_xyz():
    to_xyz = np.linalg.inv(rec709_from((1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)))
    np.testing.assert_allclose(to_xyz[1], LUMINANCE, atol=1e-4)


@pytest.mark.parametrize(
    "primaries",
    [
        (0.64, 0.33) * 3 + D65,
        (*COLOR_REC709[:6], 0.3, 0.0),
        (float("nan"), *COLOR_REC709[1:]),
        COLOR_REC709[:6],
    ],
)
def test_degenerate_primaries_are_refused(primaries):
    with pytest.raises(ValueError, match="primaries|white"):
        rec709_from(primaries)


def test_no_other_file_has_its_own_luminance_or_srgb_curve():
    root = Path(matcap.__file__).parent
    texts = {file.relative_to(root).as_posix(): file.read_text() for file in root.rglob("*.py")}
    for number in ("0.7152, 0.0722", "1.055"):
        assert [name for name, text in texts.items() if number in text] == ["files/color.py"]


# (linear light, code value): black, the knee, middle grey, half the light, white.
WORKED = [(0.0, 0.0), (0.0031308, 0.04045), (0.214041, 0.5), (0.5, 0.735357), (1.0, 1.0)]


@pytest.mark.parametrize(("light", "code"), WORKED)
def test_srgb_has_the_worked_values(light, code):
    assert srgb_encode(np.array(light)) == pytest.approx(code, abs=1e-6)
    assert srgb_decode(np.array(code)) == pytest.approx(light, abs=1e-6)


@given(st.floats(-0.5, 4.0, allow_subnormal=False))
def test_srgb_encoding_and_decoding_are_inverse(light):
    code = srgb_encode(np.array(light))
    assert srgb_decode(code) == pytest.approx(light, rel=1e-12 if 0.0 < light < 1.0 else 1e-7)


@pytest.mark.parametrize("knee", [0.0, 0.0031308])
def test_the_srgb_curve_is_continuous_at_the_knee_with_bounded_slope(knee):
    step = 1e-9
    before, at, after = srgb_encode(np.array([knee - step, knee, knee + step]))
    assert at - before == pytest.approx(12.92 * step, rel=2e-2, abs=4e-8)
    assert after - at == pytest.approx(12.92 * step, rel=2e-2, abs=4e-8)
    assert np.isfinite(srgb_encode(np.array([-1.0, 0.0, 1e-320]))).all()


def test_a_picture_is_clipped():
    found = srgb_picture(np.array([-1.0, 0.0, 0.214041, 1.0, 2.0], dtype=np.float32))
    assert found.dtype == np.float32 and found == pytest.approx([0.0, 0.0, 0.5, 1.0, 1.0], abs=1e-6)


@pytest.mark.parametrize("light", [0.0, 0.001, 0.01, 0.2, 1.0, 3.0])
def test_srgb_slope_is_the_derivative(light):
    rise = np.diff(srgb_encode(np.array([light - 1e-6, light + 1e-6])))[0] / 2e-6
    assert srgb_slope(np.array(light)) == pytest.approx(rise, rel=1e-4)
    assert srgb_slope(np.array([light], np.float32)).dtype == np.float32


def stored_inverted(path, picture, **options):
    """A grey TIFF of WhiteIsZero."""
    largest = np.iinfo(picture.dtype).max if picture.dtype.kind == "u" else 1
    codes = (largest - picture).astype(picture.dtype)
    tifffile.imwrite(path, codes, photometric="miniswhite", **options)


@pytest.mark.parametrize("tile", [None, (32, 32)])
@pytest.mark.parametrize("kind", ["uint8", "uint16", "uint32", "float16", "float32"])
def test_white_is_zero_tiffs_are_inverted_once(tmp_path, kind, tile):
    """Decoders invert 8 bits and leave the others."""
    grey = np.tile(np.linspace(0.1, 0.9, 96), (64, 1))
    dtype = np.dtype(kind)
    scaled = grey * (np.iinfo(dtype).max if dtype.kind == "u" else 1)
    scaled = np.rint(scaled) if dtype.kind == "u" else scaled
    stored_inverted(tmp_path / "a.tif", scaled.astype(dtype), tile=tile)
    np.testing.assert_allclose(read_mask(tmp_path / "a.tif"), grey, atol=4e-3)
    linear = kind.startswith("float")
    expected = grey if linear else srgb_decode(grey)
    photo = load_photo(tmp_path / "a.tif")
    np.testing.assert_allclose(photo.pixels[..., 1], expected, atol=5e-3)


def test_white_is_zero_leaves_alpha(tmp_path):
    for kind in ("uint8", "uint16"):
        largest = np.iinfo(kind).max
        codes = np.full((64, 64, 2), largest // 4, kind)
        codes[..., 1] = largest // 3 * 2
        kinds = {"photometric": "miniswhite", "extrasamples": ["unassalpha"]}
        tifffile.imwrite(tmp_path / "a.tif", codes, **kinds)
        pixels = read_pixels(tmp_path / "a.tif")
        assert float(pixels.channel("R")[0, 0]) == pytest.approx(0.75, abs=0.01)
        assert float(pixels.channel("A")[0, 0]) == pytest.approx(0.667, abs=0.01)


def test_a_thumbnail_s_channels_are_not_the_picture_s(tmp_path):
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(np.zeros((12, 12, 3), np.uint8), photometric="rgb", subfiletype=1)
        file.write(np.full((96, 96), 200, np.uint8), photometric="minisblack")
    pixels = read_pixels(tmp_path / "a.tif")
    assert pixels.grey and pixels.colours().shape == (96, 96, 3)


@pytest.mark.parametrize(("kind", "half"), [("uint32", 2**31), ("int32", 2**30), ("int16", 2**14)])
def test_integers_of_other_types_are_codes(tmp_path, kind, half):
    tifffile.imwrite(tmp_path / "a.tif", np.full((8, 8, 3), half, kind), photometric="rgb")
    colours, _ = linear_colours(read_pixels(tmp_path / "a.tif"))
    np.testing.assert_allclose(colours, srgb_decode(np.array(0.5)), atol=1e-4)


@pytest.mark.parametrize("suffix", ["jpg", "tif", "png"])
@pytest.mark.parametrize("orientation", range(2, 9))
def test_exif_orientation_is_applied_and_noted(tmp_path, suffix, orientation):
    picture = np.zeros((16, 32, 3), np.uint8)
    picture[:8, :8] = 255
    tags = Image.Exif()
    tags[274] = orientation
    Image.fromarray(picture).save(tmp_path / f"a.{suffix}", exif=tags)
    pixels = read_pixels(tmp_path / f"a.{suffix}")
    expected = np.asarray(ImageOps.exif_transpose(Image.open(tmp_path / f"a.{suffix}")))
    np.testing.assert_allclose(pixels.stored, expected, atol=16)
    assert str(orientation) in pixels.notes[0]


def exr_of(path, *parts):
    """Each part: a name and channels by name."""
    whole = [
        OpenEXR.Part({"type": OpenEXR.scanlineimage, "name": name, **more}, channels)
        for name, channels, more in parts
    ]
    OpenEXR.File(whole).write(str(path))


def plane(value):
    return np.full((8, 16), value, np.float32)


def rgb(value, layer=""):
    return {f"{layer}{channel}": plane(value) for channel in "RGB"}


def test_the_beauty_or_wanted_layer_of_an_exr_is_read(tmp_path):
    """Beauty and the like go before passes, a layer of the wanted name before both."""
    path = tmp_path / "a.exr"
    layers = rgb(0.5, "ViewLayer.AO.") | rgb(2.0, "ViewLayer.Combined.") | rgb(1.0, "View.Normal.")
    exr_of(path, ("", layers, {}))
    pixels = read_pixels(path)
    assert pixels.channel("R")[0, 0] == 2.0
    assert "3 pictures" in pixels.notes[0] and "ViewLayer.Combined is read" in pixels.notes[0]
    assert read_pixels(path, wanted=("normal",)).channel("G")[0, 0] == 1.0
    exr_of(path, ("depth", {"Z": plane(7.0)}, {}), ("beauty", rgb(3.0), {}))
    assert read_pixels(path).channel("B")[0, 0] == 3.0
    exr_of(path, ("", rgb(3.0) | {"Z": plane(7.0)}, {}))
    assert read_pixels(path).channel("B")[0, 0] == 3.0
    exr_of(path, ("left", rgb(1.0), {}), ("right", rgb(2.0), {}))
    assert read_pixels(path).channel("B")[0, 0] == 1.0
    assert "left is read" in read_pixels(path).notes[0]


@pytest.mark.parametrize(
    ("space", "expected"),
    [
        ("lin_rec709_scene", (0.2, 0.4, 0.1)),
        ("lin_ap1_scene", (0.0840, 0.4292, 0.0589)),
        ("srgb_rec709_scene", tuple(srgb_decode(np.array((0.2, 0.4, 0.1))))),
        ("g22_rec709_display", tuple(np.array((0.2, 0.4, 0.1)) ** 2.2)),
    ],
)
def test_the_interop_id_of_an_exr_is_its_colour_space(tmp_path, space, expected):
    path = tmp_path / "a.exr"
    channels = {c: plane(v) for c, v in zip("RGB", (0.2, 0.4, 0.1), strict=True)}
    exr_of(path, ("", channels, {"colorInteropID": space}))
    colours, _ = linear_colours(read_pixels(path))
    np.testing.assert_allclose(colours[0, 0], expected, atol=2e-3)


def test_an_unknown_interop_id_is_noted(tmp_path):
    exr_of(tmp_path / "a.exr", ("", rgb(0.5), {"colorInteropID": "lin_martian_scene"}))
    colours, notes = linear_colours(read_pixels(tmp_path / "a.exr"))
    assert colours[0, 0, 0] == 0.5 and "lin_martian_scene" in notes[0]


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("cut", [1, 2, 3, 5, 40])
def test_a_jpeg_may_lack_its_end_marker_and_no_more(tmp_path, progressive, cut):
    codes = np.random.default_rng(1).integers(0, 256, (96, 128, 3)).astype(np.uint8)
    path = tmp_path / "a.jpg"
    Image.fromarray(codes).save(path, progressive=progressive)
    expected, photo = read_pixels(path), load_photo(path)
    path.write_bytes(path.read_bytes()[:-cut])
    if cut > 2:
        for read in (read_pixels, load_photo):
            with pytest.raises(MatcapError, match="truncated"):
                read(path)
        return
    pixels = read_pixels(path)
    np.testing.assert_array_equal(pixels.stored, expected.stored)
    assert "end marker" in pixels.notes[0]
    np.testing.assert_array_equal(load_photo(path).pixels, photo.pixels)
