"""Colour spaces that files state, each against patches coded by the standard's own formula."""

import struct
import zlib

import numpy as np
import pytest
import tifffile
from icc_files import matrix_profile, parametric
from PIL import Image

from matcap.files.color import SRGB, ColorSpace, hlg_decode, pq_decode, space_of_code_points
from matcap.files.png import png_chunk
from matcap.files.rec709 import rec709_from
from matcap.files.srgb import srgb_encode
from matcap.files.stated_color import StatedColor, stated_color
from matcap.photo.load import load_photo

REC709 = np.array([[0.5, 0.2, 0.1], [0.1, 0.4, 0.3], [0.05, 0.1, 0.6], [0.7, 0.7, 0.7]])
D65 = (0.3127, 0.3290)
P3 = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *D65)
BT2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *D65)
ADOBE = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, *D65)
BEST = {"quality": 100, "subsampling": 0}


def pq(light):
    """SMPTE ST 2084's inverse EOTF, of parts of 203 cd/m2."""
    y = (np.maximum(light, 0.0) * 203.0 / 10_000.0) ** (2610 / 16384)
    return ((3424 / 4096 + 2413 / 128 * y) / (1 + 2392 / 128 * y)) ** (2523 / 32)


def hlg(light):
    """Display light on 1000 cd/m2 to scene light to signal (BT.2100, table 5)."""
    nits = np.maximum(light, 0.0) * 203.0 / 1000.0
    luminance = nits @ [0.2627, 0.6780, 0.0593]
    scene = nits * luminance[..., None] ** ((1 - 1.2) / 1.2)
    a, b, c = 0.17883277, 1 - 4 * 0.17883277, 0.5 - 0.17883277 * np.log(4 * 0.17883277)
    return np.where(scene <= 1 / 12, np.sqrt(3 * scene), a * np.log(12 * scene - b) + c)


def patches(primaries, encode) -> np.ndarray:
    """(96, 128, 3) uint16: REC709's four colours in columns, in these primaries and this code."""
    own = REC709 if primaries is None else REC709 @ np.linalg.inv(rec709_from(primaries)).T
    codes = np.rint(np.clip(encode(own), 0, 1) * 65535).astype(np.uint16)
    return np.repeat(codes, 32, axis=0)[None].repeat(96, axis=0)


def write_png(path, codes, *chunks):
    """A 16-bit RGB PNG with these chunks before its picture."""
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in codes)
    head = struct.pack(">2I5B", codes.shape[1], codes.shape[0], 16, 2, 0, 0, 0)
    body = [(b"IHDR", head), *chunks, (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(*chunk) for chunk in body))
    return path


def chromaticities(primaries):
    order = (*primaries[6:], *primaries[:6])
    return b"cHRM", struct.pack(">8I", *(round(100_000 * v) for v in order))


def gamma(exponent):
    return b"gAMA", struct.pack(">I", round(100_000 / exponent))


def seen(photo):
    return photo.pixels[48, 16::32]


@pytest.mark.parametrize(
    ("primaries", "encode", "chunks", "named"),
    [
        (P3, srgb_encode, [(b"cICP", bytes((12, 13, 0, 1)))], "Display P3"),
        (BT2020, pq, [(b"cICP", bytes((9, 16, 0, 1)))], "BT.2020, PQ"),
        (BT2020, hlg, [(b"cICP", bytes((9, 18, 0, 1)))], "BT.2020, HLG"),
        (None, lambda v: v, [(b"cICP", bytes((1, 8, 0, 1)))], "linear"),
        (P3, srgb_encode, [chromaticities(P3)], "primaries"),
        (ADOBE, lambda v: v ** (1 / 2.2), [gamma(2.2), chromaticities(ADOBE)], "gamma 2.2"),
        (None, lambda v: v ** (1 / 1.8), [gamma(1.8)], "gamma 1.8"),
        (None, lambda v: v, [gamma(1.0)], "gamma 1"),
        (None, srgb_encode, [gamma(2.2)], None),
        (None, srgb_encode, [(b"sRGB", b"\0"), gamma(1.8)], None),
        (P3, srgb_encode, [(b"cICP", bytes((12, 13, 0, 1))), gamma(1.0)], "Display P3"),
    ],
    ids=lambda each: getattr(each, "__name__", str(each)),
)
def test_png(tmp_path, primaries, encode, chunks, named):
    photo = load_photo(write_png(tmp_path / "a.png", patches(primaries, encode), *chunks))
    np.testing.assert_allclose(seen(photo), REC709, atol=2e-3)
    assert [named in note for note in photo.notes] == ([True] if named else [])


@pytest.mark.parametrize(
    "chunks",
    [
        [(b"cICP", bytes((200, 13, 0, 1)))],
        [(b"cICP", bytes((7, 7, 0, 1)))],
        [(b"cICP", bytes((1, 77, 0, 1)))],
        [(b"gAMA", b"\0\0\0\0")],
        [(b"cHRM", bytes(32))],
        [(b"iCCP", b"broken")],
    ],
    ids=str,
)
def test_what_is_stated_and_cannot_be_read_is_said(tmp_path, chunks):
    photo = load_photo(write_png(tmp_path / "a.png", patches(None, srgb_encode), *chunks))
    np.testing.assert_allclose(seen(photo), REC709, atol=2e-3)
    assert len(photo.notes) == 1 and "sRGB assumed" in photo.notes[0]


def test_the_profile_of_the_page_that_is_read(tmp_path):
    """And its orientation: a thumbnail before it has neither."""
    codes = patches(P3, srgb_encode)
    turned = {"iccprofile": matrix_profile(), "extratags": [(274, 3, 1, 3, True)]}
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(codes[:64, :64] >> 1, photometric="rgb", subfiletype=1)
        file.write(codes[::-1, ::-1], photometric="rgb", **turned)
    photo = load_photo(tmp_path / "a.tif")
    np.testing.assert_allclose(seen(photo), REC709, atol=2e-3)
    assert any("Display P3" in note for note in photo.notes)


def test_a_profile_that_lacks_a_part_is_told_of(tmp_path):
    path = tmp_path / "a.jpg"
    eight_bits(patches(None, srgb_encode)).save(path, icc_profile=matrix_profile(), quality=100)
    data = path.read_bytes()
    at = data.index(b"ICC_PROFILE\0") + 13
    path.write_bytes(data[:at] + b"\2" + data[at + 1 :])  # one of two
    assert "cannot be read: sRGB assumed" in load_photo(path).notes[0]


def test_floats_of_a_profile_that_is_broken_stay_light(tmp_path, light):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, light.astype(np.float32), photometric="rgb", iccprofile=b"broken")
    photo = load_photo(path)
    np.testing.assert_allclose(photo.pixels, light, rtol=1e-6)
    assert "linear Rec.709 assumed" in photo.notes[0]


def exif_of(index=None, color_space=None):
    tags = Image.Exif()
    if color_space is not None:
        tags.get_ifd(0x8769)[0xA001] = color_space
    if index is not None:
        tags.get_ifd(0x8769)[0xA005] = {1: index}
    return tags


def eight_bits(codes):
    return Image.fromarray((codes >> 8).astype(np.uint8))


@pytest.mark.parametrize(("index", "color_space"), [("R03", 65535), (None, 2)])
def test_adobe_rgb_of_a_camera_without_a_profile(photo_of, index, color_space):
    codes = patches(ADOBE, lambda v: v ** (256 / 563))
    photo = photo_of(eight_bits(codes), "a.jpg", **BEST, exif=exif_of(index, color_space))
    np.testing.assert_allclose(seen(photo), REC709, atol=1e-2)
    assert any("Adobe RGB" in note for note in photo.notes)


def test_sixty_five_thousand_colours_of_r98_are_srgb(photo_of):
    picture = eight_bits(patches(None, srgb_encode))
    assert photo_of(picture, "a.jpg", **BEST, exif=exif_of("R98", 1)).notes == ()
    assert "uncalibrated" in photo_of(picture, "b.jpg", **BEST, exif=exif_of(None, 65535)).notes[0]


def test_a_profile_goes_before_exif(photo_of):
    picture, given = eight_bits(patches(P3, srgb_encode)), {"icc_profile": matrix_profile()}
    photo = photo_of(picture, "a.jpg", **BEST, **given, exif=exif_of("R03", 65535))
    np.testing.assert_allclose(seen(photo), REC709, atol=1e-2)
    assert len(photo.notes) == 1


def test_primaries_of_a_tiff(tmp_path):
    rational = [n for v in P3 for n in (round(10_000 * v), 10_000)]
    tags = [(319, 5, 6, rational[:12], True), (318, 5, 2, rational[12:], True)]
    codes = patches(P3, srgb_encode)
    tifffile.imwrite(tmp_path / "a.tif", codes, photometric="rgb", extratags=tags)
    photo = load_photo(tmp_path / "a.tif")
    np.testing.assert_allclose(seen(photo), REC709, atol=2e-3)
    assert any("primaries" in note for note in photo.notes)


def grey_profile(exponent: float) -> bytes:
    """A grey profile: that of matrices with another head, and red's curve as grey's."""
    profile = bytearray(matrix_profile(curve=parametric(0, exponent), space=b"GRAY", name="grey"))
    at = profile.index(b"rTRC")
    profile[at : at + 4] = b"kTRC"
    return bytes(profile)


@pytest.mark.parametrize("form", ["jpg", "png", "tif"])
def test_grey_profiles_are_followed(tmp_path, form):
    levels = np.array([0.05, 0.2, 0.4, 0.8])
    codes = np.rint(255 * np.sqrt(levels)).astype(np.uint8).repeat(32)[None].repeat(96, axis=0)
    options = {"quality": 100} if form == "jpg" else {}
    path = tmp_path / f"a.{form}"
    Image.fromarray(codes).save(path, icc_profile=grey_profile(2.0), **options)
    photo = load_photo(path)
    np.testing.assert_allclose(seen(photo), levels[:, None].repeat(3, 1), atol=5e-3)
    assert any("grey" in note for note in photo.notes)


def with_nclx(path, primaries, transfer):
    """The file with other code points: a decoder that is told them changes nothing of the codes."""
    data = bytearray(path.read_bytes())
    at = data.index(b"colrnclx") + 8
    data[at : at + 4] = struct.pack(">2H", primaries, transfer)
    path.write_bytes(data)


@pytest.mark.parametrize("form", ["avif", "heic"])
def test_nclx(tmp_path, form):
    path = tmp_path / f"a.{form}"
    picture = eight_bits(patches(P3, srgb_encode))
    if form == "heic":
        heif = pytest.importorskip("pillow_heif").from_pillow(picture)
        heif.save(path, quality=100, chroma=444)
    else:
        picture.save(path, quality=100, subsampling="4:4:4")
    with_nclx(path, 12, 13)
    assert stated_color(path).space.name.startswith("Display P3")
    if form == "heic":
        photo = load_photo(path)
        np.testing.assert_allclose(seen(photo), REC709, atol=2e-2)
        assert any("Display P3" in note for note in photo.notes)


def test_worked_values_of_the_curves():
    """Diffuse white of BT.2408 is 58 % of PQ and 75 % of HLG."""
    assert pq_decode(np.array(0.5806888)) == pytest.approx(1.0, rel=1e-4)
    white = hlg_decode(np.array(0.75))
    assert white**1.2 == pytest.approx(1.0, rel=1e-2)
    assert space_of_code_points(2, 2) is SRGB and space_of_code_points(3, 1) is None


def test_a_profile_by_code_points(codes):
    """ICC.1:2022's cicp, as profiles of HDR pictures have beside their tables."""
    profile = bytearray(matrix_profile())
    at = profile.index(b"wtpt")
    profile[at : at + 4] = b"cicp"
    (offset,) = struct.unpack_from(">I", profile, at + 4)
    profile[offset : offset + 12] = b"cicp" + bytes(4) + bytes((9, 16, 0, 1))
    linearise, notes = StatedColor(bytes(profile)).lineariser(codes.dtype)
    expected = space_of_code_points(9, 16)
    assert isinstance(expected, ColorSpace) and "PQ" in notes[0]
    np.testing.assert_array_equal(linearise(codes), expected.lineariser(codes.dtype)(codes))
