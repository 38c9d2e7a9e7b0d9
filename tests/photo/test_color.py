"""Colour of photographs: DNG tags, stated colour spaces."""

import io
import struct
import zlib
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from icc_files import (
    P3_COLORANTS,
    REC709_COLORANTS,
    SRGB_CURVE,
    gamma_curve,
    matrix_profile,
    parametric,
    table_curve,
    table_profile,
)
from PIL import Image, ImageCms
from simulated.files import XYZ_TO_REC709, color_matrix, mosaic, rationals, write_dng

from matcap.files.color import (
    SRGB,
    ColorSpace,
    hlg_decode,
    pq_decode,
    rec709_from,
    space_of_code_points,
    srgb_decode,
    srgb_encode,
)
from matcap.files.pixels import png_chunk
from matcap.files.stated_color import StatedColor, lineariser_of, stated_color
from matcap.photo.dng import dng_color, temperature
from matcap.photo.load import load_photo
from matcap.photo.photo import SHOULDER, ToneCurve

# Transfer functions, profiles and tone curves, against closed forms and littleCMS.


# Linear Display P3 to linear Rec.709, both D65: from the primaries' chromaticities.
P3_TO_REC709 = np.array(
    [
        [1.2249402, -0.2249402, 0.0],
        [-0.0420570, 1.0420570, 0.0],
        [-0.0196376, -0.0786361, 1.0982735],
    ]
)


def test_srgb_profiles_change_nothing(codes):
    made = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    for profile in (made, matrix_profile(REC709_COLORANTS, name="sRGB IEC61966-2.1")):
        linearise, notes = lineariser_of(profile, codes.dtype, SRGB)
        np.testing.assert_allclose(linearise(codes), SRGB.lineariser(codes.dtype)(codes), atol=2e-5)
        assert notes == ()


@pytest.mark.parametrize(
    "curve",
    [
        parametric(3, *SRGB_CURVE),
        parametric(4, *SRGB_CURVE, 0.0, 0.0),
        parametric(0, 1.8),
        parametric(1, 2.2, 1 / 1.1, 0.1 / 1.1),
        parametric(2, 2.0, 0.9, 0.05, 0.02),
        gamma_curve(2.2),
        table_curve([round(65535 * (i / 255) ** 2) for i in range(256)]),
    ],
)
def test_agrees_with_littlecms(codes, curve):
    """Within what 8 bits of littleCMS's answer can tell, inside the gamut of both."""
    muted = (64 + codes // 2).astype(np.uint8)
    profile = matrix_profile(P3_COLORANTS, curve)
    linearise, _ = lineariser_of(profile, muted.dtype, SRGB)
    source = ImageCms.getOpenProfile(io.BytesIO(profile))
    answer = ImageCms.profileToProfile(
        Image.fromarray(muted), source, ImageCms.createProfile("sRGB"), renderingIntent=1
    )
    ours = 255 * srgb_encode(linearise(muted).astype(np.float64))
    inside = (ours > 1).all(-1) & (ours < 254).all(-1)
    assert inside.mean() > 0.5 and np.abs(ours - np.asarray(answer))[inside].max() < 1.6


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_table_profile_agrees_with_the_same_as_matrix(codes, dtype):
    largest = 1 if dtype is np.float32 else np.iinfo(dtype).max
    stored = (codes / 255 * largest).astype(dtype)
    linearise, notes = lineariser_of(table_profile(1.8), stored.dtype, SRGB)
    same, _ = lineariser_of(
        matrix_profile(REC709_COLORANTS, parametric(0, 1.8)), stored.dtype, SRGB
    )
    np.testing.assert_allclose(
        srgb_encode(linearise(stored)), srgb_encode(same(stored)), atol=1.2 / 255
    )
    assert "8 bits" in notes[0]


@pytest.mark.parametrize(
    "profile",
    [b"junk", bytes(200), matrix_profile()[:300], matrix_profile(space=b"GRAY")],
    ids=["junk", "zeros", "short", "grey"],
)
def test_unusable_profile_is_reported(codes, profile):
    linearise, notes = lineariser_of(profile, codes.dtype, SRGB)
    np.testing.assert_array_equal(linearise(codes), SRGB.lineariser(codes.dtype)(codes))
    assert len(notes) == 1 and "assumed" in notes[0]


def test_curve_that_leaves_all_bounds_is_not_followed(codes):
    profile = matrix_profile(curve=parametric(0, -3.0))
    linearise, notes = lineariser_of(profile, codes.dtype, SRGB)
    assert np.isfinite(linearise(codes)).all() and notes


def test_p3_jpeg_comes_out_as_rec709(photo_of):
    rec709 = np.array([[0.5, 0.2, 0.1], [0.1, 0.4, 0.3], [0.05, 0.1, 0.6], [0.7, 0.7, 0.7]])
    p3 = rec709 @ np.linalg.inv(P3_TO_REC709).T
    patches = np.rint(255 * srgb_encode(p3)).astype(np.uint8)
    picture = np.repeat(patches, 32, axis=0)[None].repeat(96, axis=0)
    options = {"quality": 100, "subsampling": 0}
    photo = photo_of(picture, "p3.jpg", icc_profile=matrix_profile(), **options)
    np.testing.assert_allclose(photo.pixels[48, 16::32], rec709, atol=8e-3)
    assert any("Display P3" in note for note in photo.notes)
    unmanaged = photo_of(picture, "plain.jpg", **options)
    assert np.abs(unmanaged.pixels[48, 16::32] - rec709).max() > 0.03


def test_wide_gamut_is_kept_and_never_negative(photo_of):
    picture = np.zeros((96, 128, 3), np.uint8)
    picture[..., 0] = 240
    photo = photo_of(picture, "red.png", icc_profile=matrix_profile())
    expected = srgb_decode(np.array(240 / 255)) * P3_TO_REC709[0, 0]
    np.testing.assert_allclose(photo.pixels[..., 0], expected, rtol=1e-3)
    assert expected > 1.0 and photo.pixels.min() == 0.0 and not photo.clipped.any()


PICTURE = np.linspace(0.0, 1.0, 160 * 120 * 3).reshape(120, 160, 3)


@given(st.floats(0.5, 2.0), st.floats(0.0, 0.8))
def test_undoing_the_curve_gives_the_light_back(exponent, shoulder):
    curve = ToneCurve(exponent, shoulder)
    light = np.array([0.0, 1e-4, 0.01, 0.3, 0.99, 1.0])
    developed = curve.developed(light)
    assert curve.linear(developed) == pytest.approx(light, rel=1e-9)
    assert (np.diff(developed) > 0.0).all() and developed[[0, -1]] == pytest.approx([0.0, 1.0])


def test_light_beyond_the_clip_level_stays_beyond_it_both_ways():
    curve = ToneCurve(1.2, SHOULDER)
    assert (curve.developed(np.array([1.5, 4.0])) > 1.0).all()
    assert curve.linear(np.array([1.5, 4.0])) == pytest.approx([1.5, 4.0])


@pytest.mark.parametrize(
    ("name", "codes", "mapped"),
    [
        ("a.jpg", (PICTURE * 255.0).astype(np.uint8), True),
        ("a.png", (PICTURE * 65535.0).astype(np.uint16), True),
        ("a.tif", PICTURE.astype(np.float32), False),
    ],
)
def test_coded_pictures_have_a_curve_and_floating_point_ones_none(tmp_path, name, codes, mapped):
    """Floats are linear light, as a renderer or a merging program writes them."""
    cv2.imwrite(str(tmp_path / name), codes)
    photo = load_photo(tmp_path / name)
    assert photo.tone_mapped == mapped
    undone = photo.linearised(ToneCurve(1.2, SHOULDER))
    assert not undone.tone_mapped and np.array_equal(undone.pixels, photo.pixels) == (not mapped)
    assert np.array_equal(undone.clipped, photo.clipped)


@pytest.mark.parametrize(
    ("report", "exponent"),
    [
        ({"camera": {"tone_curve": {"exponent": 1.2, "shoulder": 0.3}}}, 1.2),
        ({"camera": {"tone_curve": {"exponent": -1.0, "shoulder": 0.3}}}, 1.0),
        ({"camera": {"tone_curve": {"exponent": "1.2", "shoulder": 0.3}}}, 1.0),
        ({"camera": {"tone_curve": None}}, 1.0),
        ({"camera": []}, 1.0),
        ({}, 1.0),
    ],
)
def test_a_report_states_the_curve_of_its_photograph_or_none(report, exponent):
    assert ToneCurve.of_report(report).exponent == exponent


# White balance and colours of DNGs, as Adobe's specification has them.

D65, A = (0.3127, 0.3290), (0.44758, 0.40745)
NEUTRAL = np.array([0.5, 1.0, 0.7])
GREY = np.full((96, 128, 3), 0.4)
MIXING = np.array([[0.7, 0.25, 0.05], [0.2, 0.7, 0.1], [0.05, 0.25, 0.7]])
OTHER = np.array([[0.9, 0.05, 0.05], [0.1, 0.8, 0.1], [0.1, 0.1, 0.8]])
# What a DNG says that LibRaw alone would overlook.
WHITE_XY = (50729, 5, 2, rationals(D65), True)
SENSITIVE = np.diag(NEUTRAL) @ color_matrix(np.eye(3))  # of a camera that sees white as NEUTRAL


def xyz(white):
    x, y = white
    return np.array([x / y, 1.0, (1 - x - y) / y])


def tags(matrix, **more):
    """As tifffile hands them over: `color2`, `kelvin` and so on by name."""
    number = {
        "color2": 50722, "own1": 50723, "own2": 50724, "balance": 50727, "neutral": 50728,
        "white": 50729, "forward1": 50964, "forward2": 50965,
    }  # fmt: skip
    kinds = {50778: more.pop("kind1", 21), 50779: more.pop("kind2", 0)}
    stated = {50721: matrix} | {number[name]: value for name, value in more.items()}
    return {code: SimpleNamespace(value=kind, dtype=3) for code, kind in kinds.items()} | {
        code: SimpleNamespace(value=rationals(np.ravel(value)), dtype=10)
        for code, value in stated.items()
    }


@pytest.mark.parametrize(
    ("more", "says"),
    [((WHITE_XY,), "white point (0.3127, 0.3290)"), ((), "daylight (D65) assumed")],
    ids=["white", "nothing"],
)
def test_a_dng_without_a_neutral_is_balanced_by_its_matrix(tmp_path, more, says):
    """Grey of any picture stays grey, and a brown one brown: no grey world."""
    for light in (GREY, GREY * [1.5, 1.0, 0.5]):
        path = write_dng(
            tmp_path / "a.dng", mosaic(light * NEUTRAL), neutral=None, color_matrix=SENSITIVE,
            more=more,
        )  # fmt: skip
        photo = load_photo(path)
        np.testing.assert_allclose(photo.pixels.mean((0, 1)), light[0, 0], atol=2e-3)
        assert [says in note for note in photo.notes] == [True]
        np.testing.assert_allclose(photo.balance, NEUTRAL.max() / NEUTRAL, rtol=1e-3)


def test_as_shot_neutral_overrides_a_white_point(tmp_path):
    path = write_dng(
        tmp_path / "a.dng", mosaic(GREY * NEUTRAL), neutral=tuple(NEUTRAL), more=[WHITE_XY]
    )
    photo = load_photo(path)
    np.testing.assert_allclose(photo.pixels.mean((0, 1)), 0.4, atol=1e-3)
    assert photo.notes == ()


def test_temperatures_of_known_whites():
    assert temperature(A) == pytest.approx(2856, abs=5)
    assert temperature(D65) == pytest.approx(6504, abs=5)


def test_matrices_are_mixed_by_the_inverse_temperature():
    """At 2850 K the first illuminant's, at 6500 K the second's, half of each between in 1 / T."""
    first, second = color_matrix(MIXING), color_matrix(OTHER)
    middle = 2.0 / (1.0 / 2850.0 + 1.0 / 6500.0)
    x = next(x for x in np.linspace(0.30, 0.45, 4001)[::-1] if temperature((x, 0.38)) >= middle)
    for white, mixed in [(A, first), (D65, second), ((float(x), 0.38), (first + second) / 2)]:
        found = dng_color(tags(first, color2=second, kind1=17, kind2=21, white=white))
        expected = mixed @ xyz(white)
        np.testing.assert_allclose(found.neutral, expected / expected.max(), rtol=2e-3)
        # The same white told as its camera colours gives the same colours.
        same = dng_color(tags(first, color2=second, kind1=17, kind2=21, neutral=found.neutral))
        np.testing.assert_allclose(same.matrix, found.matrix, atol=2e-3)


def test_one_illuminant_that_is_not_known_leaves_the_first_matrix():
    alone = dng_color(tags(color_matrix(MIXING), white=D65))
    for kind in (0, 21):
        both = tags(color_matrix(MIXING), color2=color_matrix(OTHER), kind2=kind, white=D65)
        np.testing.assert_array_equal(dng_color(both).matrix, alone.matrix)


def test_calibration_and_analog_balance_are_the_camera_s_own():
    own, gains = np.diag([0.8, 1.0, 1.3]), np.array([1.2, 1.0, 0.9])
    stated = tags(color_matrix(MIXING), own1=own, balance=gains, white=D65)
    expected = np.diag(gains) @ own @ color_matrix(MIXING) @ xyz(D65)
    np.testing.assert_allclose(dng_color(stated).neutral, expected / expected.max(), rtol=1e-5)
    # Which the profile's matrices are not for.
    stated[50931] = SimpleNamespace(value="another calibration", dtype=2)
    expected = np.diag(gains) @ color_matrix(MIXING) @ xyz(D65)
    np.testing.assert_allclose(dng_color(stated).neutral, expected / expected.max(), rtol=1e-5)


def test_colours_follow_the_forward_matrix(tmp_path):
    """It goes to XYZ relative to D50; here of a camera that mixes like OTHER once balanced."""
    rec709 = np.zeros((96, 128, 3))
    rec709[:, :64], rec709[:, 64:] = (0.5, 0.2, 0.1), (0.1, 0.3, 0.6)
    balanced = OTHER / OTHER.sum(axis=1, keepdims=True)
    to_d50 = [[0.4360747, 0.3850649, 0.1430804], [0.2225045, 0.7168786, 0.0606169],
              [0.0139322, 0.0971045, 0.7141733]]  # fmt: skip
    forward = np.array(to_d50) @ np.linalg.inv(balanced)
    photo = load_photo(
        write_dng(
            tmp_path / "a.dng",
            mosaic(rec709 @ balanced.T * NEUTRAL),
            neutral=tuple(NEUTRAL),
            more=[(50964, 10, 9, rationals(np.ravel(forward)), True)],
        )
    )
    inner = np.r_[4:60, 68:124]
    np.testing.assert_allclose(photo.pixels[4:-4, inner], rec709[4:-4, inner], atol=2e-3)


@pytest.mark.parametrize("white", [(0.0, 0.0), (0.99, 0.3), (0.3, -0.1)])
def test_an_impossible_white_point_is_not_followed(white):
    assert "daylight" in dng_color(tags(XYZ_TO_REC709, white=white)).note


def test_a_camera_without_a_colour_matrix_is_noted(tmp_path):
    path = write_dng(tmp_path / "a.dng", mosaic(GREY * NEUTRAL), neutral=tuple(NEUTRAL))
    assert load_photo(path).notes == ()
    entry, none = (struct.pack("<HHI", tag, 10, 9) for tag in (50721, 50720))
    path.write_bytes(path.read_bytes().replace(entry, none))
    photo = load_photo(path)
    np.testing.assert_allclose(photo.pixels.mean((0, 1)), 0.4, atol=1e-3)
    assert "no colour matrix" in photo.notes[0]


def test_a_missing_or_singular_colour_matrix_gives_no_colour():
    without = tags(np.eye(3), neutral=NEUTRAL)
    del without[50721]
    assert dng_color(without) is None
    with pytest.raises(ValueError, match="basis|white|singular|Singular"):
        dng_color(tags(np.ones((3, 3)), white=D65))


# Colour spaces that files state, each against patches coded by the standard's own formula.

REC709 = np.array([[0.5, 0.2, 0.1], [0.1, 0.4, 0.3], [0.05, 0.1, 0.6], [0.7, 0.7, 0.7]])
STATED_COLOR_D65 = (0.3127, 0.3290)
P3 = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *STATED_COLOR_D65)
BT2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *STATED_COLOR_D65)
ADOBE = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, *STATED_COLOR_D65)
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
def test_colour_chunks_of_png_are_followed(tmp_path, primaries, encode, chunks, named):
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
def test_an_unreadable_colour_statement_is_noted(tmp_path, chunks):
    photo = load_photo(write_png(tmp_path / "a.png", patches(None, srgb_encode), *chunks))
    np.testing.assert_allclose(seen(photo), REC709, atol=2e-3)
    assert len(photo.notes) == 1 and "sRGB assumed" in photo.notes[0]


def test_the_profile_is_that_of_the_tiff_page_read(tmp_path):
    """And its orientation: a thumbnail before it has neither."""
    codes = patches(P3, srgb_encode)
    turned = {"iccprofile": matrix_profile(), "extratags": [(274, 3, 1, 3, True)]}
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(codes[:64, :64] >> 1, photometric="rgb", subfiletype=1)
        file.write(codes[::-1, ::-1], photometric="rgb", **turned)
    photo = load_photo(tmp_path / "a.tif")
    np.testing.assert_allclose(seen(photo), REC709, atol=2e-3)
    assert any("Display P3" in note for note in photo.notes)


def test_an_incomplete_profile_is_noted(tmp_path):
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


def test_a_profile_overrides_the_colour_space_of_exif(photo_of):
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
def test_colour_code_points_of_nclx_are_followed(tmp_path, form):
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
    assert hlg_decode(np.array(0.75)) ** 1.2 == pytest.approx(1.0, rel=1e-2)
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
