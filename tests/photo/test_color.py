"""Transfer functions, profiles and tone curves, against closed forms and littleCMS."""

import io

import cv2
import numpy as np
import pytest
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

from matcap.files.color import SRGB
from matcap.files.icc import lineariser_of, read_profile
from matcap.files.srgb import srgb_decode, srgb_encode
from matcap.photo.load import load_photo
from matcap.photo.tone import SHOULDER, ToneCurve

# Linear Display P3 to linear Rec.709, both D65: from the primaries' chromaticities.
P3_TO_REC709 = np.array(
    [
        [1.2249402, -0.2249402, 0.0],
        [-0.0420570, 1.0420570, 0.0],
        [-0.0196376, -0.0786361, 1.0982735],
    ]
)


def test_integer_tables_are_the_curve():
    codes = np.arange(65536, dtype=np.uint16).reshape(256, 256)[..., None].repeat(3, -1)
    light = SRGB.lineariser(codes.dtype)(codes)
    np.testing.assert_allclose(light, srgb_decode(codes / 65535), rtol=1e-6)


def test_p3_matrix():
    space = read_profile(matrix_profile())
    assert space.name == "Display P3"
    np.testing.assert_allclose(space.matrix, P3_TO_REC709, atol=5e-4)
    np.testing.assert_allclose(space.matrix.sum(axis=1), 1.0, atol=1e-12)  # grey stays grey


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
    assert inside.mean() > 0.5
    assert np.abs(ours - np.asarray(answer))[inside].max() < 1.6


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
    [
        b"junk",
        bytes(200),
        matrix_profile()[:300],
        matrix_profile(space=b"GRAY"),
    ],
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
    measured = photo.pixels[48, 16::32]
    np.testing.assert_allclose(measured, rec709, atol=8e-3)
    assert any("Display P3" in note for note in photo.notes)
    unmanaged = photo_of(picture, "plain.jpg", **options)
    assert np.abs(unmanaged.pixels[48, 16::32] - rec709).max() > 0.03


def test_wide_gamut_is_kept_and_never_negative(photo_of):
    picture = np.zeros((96, 128, 3), np.uint8)
    picture[..., 0] = 240
    photo = photo_of(picture, "red.png", icc_profile=matrix_profile())
    expected = srgb_decode(np.array(240 / 255)) * P3_TO_REC709[0, 0]
    np.testing.assert_allclose(photo.pixels[..., 0], expected, rtol=1e-3)
    assert expected > 1.0 and photo.pixels.min() == 0.0
    assert not photo.clipped.any()


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


def test_by_default_the_curve_is_the_identity():
    assert ToneCurve().developed(PICTURE) is PICTURE and ToneCurve().linear(PICTURE) is PICTURE


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
    assert not undone.tone_mapped
    assert np.array_equal(undone.pixels, photo.pixels) == (not mapped)
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
