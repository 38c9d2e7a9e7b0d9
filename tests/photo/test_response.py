"""Ratios of exposures and the tone curve that two photographs share, from values of both."""

import math

import numpy as np
import pytest

from matcap.photo.photo import WITH_GAIN_MAP, Development, ToneCurve
from matcap.photo.response import fit_ratio

LIGHT = np.exp(np.random.default_rng(1).uniform(math.log(0.02), math.log(0.95), (10_000, 2)))
CODED, LINEAR = Development(), None


def noisy(values, deviation=0.01):
    return values * (1.0 + deviation * np.random.default_rng(2).standard_normal(values.shape))


@pytest.mark.parametrize("stops", [1, 2, 4])
@pytest.mark.parametrize("curve", [(1.0, 0.0), (1.13, 0.27), (1.3, 0.57), (1.05, 0.78)])
def test_curve_and_ratio_are_found(stops, curve):
    tone, k = ToneCurve(*curve), 2.0**-stops
    brighter, darker = tone.developed(LIGHT), noisy(tone.developed(k * LIGHT))
    ratio = fit_ratio(brighter, darker, (CODED, CODED), k)
    assert ratio.darker == pytest.approx(k, rel=0.02)
    again = ratio.curve.linear(brighter) / LIGHT
    assert np.std(np.log(again)) < 0.05 and ratio.residual < 0.03


def test_without_metadata_the_exponent_is_the_priors():
    tone, k = ToneCurve(math.exp(0.12), 0.4), 1 / 8
    ratio = fit_ratio(tone.developed(LIGHT), tone.developed(k * LIGHT), (CODED, CODED), None)
    assert ratio.darker == pytest.approx(k, rel=0.05)


@pytest.mark.parametrize("stated", [0.9, 1e-4, 2.0])
def test_metadata_that_no_curve_explains_is_ignored(stated):
    tone, k = ToneCurve(math.exp(0.12), 0.4), 1 / 8
    values = tone.developed(LIGHT), tone.developed(k * LIGHT)
    assert fit_ratio(*values, (CODED, CODED), stated) == fit_ratio(*values, (CODED, CODED), None)


def test_linear_pictures_have_no_curve():
    ratio = fit_ratio(LIGHT, noisy(LIGHT / 16.0, 0.1), (LINEAR, LINEAR), 1 / 4)
    assert ratio.curve is None and ratio.darker == pytest.approx(1 / 16, rel=0.01)


@pytest.mark.parametrize("brighter_is_coded", [True, False])
def test_a_linear_picture_measures_the_others_curve(brighter_is_coded):
    tone, k = ToneCurve(1.3, 0.57), 1 / 8
    first, second = LIGHT, k * LIGHT
    if brighter_is_coded:
        ratio = fit_ratio(tone.developed(first), noisy(second), (CODED, LINEAR), None)
    else:
        ratio = fit_ratio(first, noisy(tone.developed(second)), (LINEAR, CODED), None)
    coded = tone.developed(first if brighter_is_coded else second)
    again = ratio.curve.linear(coded) / (first if brighter_is_coded else second)
    assert np.std(np.log(again)) < 0.05
    # The unit of the coded one is its own white: the ratio is of light by the fitted curve.
    expected = k / np.median(again) if brighter_is_coded else k * np.median(again)
    assert ratio.darker == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("curve", [(1.0, 0.0), (1.13, 0.27), (1.3, 0.57), (1.05, 0.78)])
@pytest.mark.parametrize("stops", [1, 2, 4])
def test_a_stated_ratio_decides_what_a_darker_jpeg_and_light_leave_open(stops, curve):
    """Tones alone give 1.4 to 1.7 stops of two by a strong shoulder: a weaker one fits as well."""
    tone, k = ToneCurve(*curve), 2.0**-stops
    values = LIGHT, noisy(tone.developed(k * LIGHT))
    ratio = fit_ratio(*values, (LINEAR, CODED), k)
    assert math.log2(ratio.darker / k) == pytest.approx(0.0, abs=0.2)
    assert np.std(np.log(ratio.curve.linear(values[1]) / LIGHT)) < 0.05
    # A wrong one is outvoted by tones where these tell: a JPEG brighter than the light.
    values = tone.developed(LIGHT), noisy(k * LIGHT)
    ratio = fit_ratio(*values, (CODED, LINEAR), 0.7 * k)
    assert math.log2(ratio.darker / k) == pytest.approx(0.0, abs=0.2)


def test_gain_maps_have_no_shoulder():
    tones = WITH_GAIN_MAP
    ratio = fit_ratio(LIGHT**1.04, (LIGHT / 8.0) ** 1.04, (tones, tones), 1 / 8)
    assert ratio.curve.shoulder == 0.0 and ratio.curve.exponent == pytest.approx(1.04, rel=0.01)


def test_few_common_tones_give_no_estimate():
    assert fit_ratio(LIGHT[:40], LIGHT[:40] / 4, (CODED, CODED), 0.25) is None


def test_other_light_leaves_a_residual():
    tone = ToneCurve(1.13, 0.27)
    other = LIGHT**0.3 / 8.0  # a picture whose light does not rise with the first one's
    ratio = fit_ratio(tone.developed(LIGHT), tone.developed(other), (LINEAR, LINEAR), None)
    assert ratio.residual > 0.15
