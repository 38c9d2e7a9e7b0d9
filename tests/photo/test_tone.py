"""The tone curve of developed pictures, and which files have one."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from matcap.photo.load import load_photo
from matcap.photo.tone import SHOULDER, ToneCurve

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
