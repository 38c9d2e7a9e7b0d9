"""One falloff for the photographs of a camera, whatever they show."""

import math
from dataclasses import replace

import numpy as np
import pytest
from uniform import a_setup, photograph

from matcap.capture.camera_profile import camera_profile, shared_falloff
from matcap.flash.coarse.fit import fit_coarse
from matcap.flash.coarse.problem import FalloffLikelihood
from matcap.photo.camera import CameraProfile, Falloff
from matcap.photo.tone import SHOULDER, ToneCurve

TRUE = (0.6, 1.1)
# Albedo, roughness and the flash's offset.
MATERIALS = (
    ((0.3, 0.25, 0.2), 0.8, (0.1, 0.05, 0.0)),
    ((0.1, 0.12, 0.2), 0.6, (0.08, 0.1, 0.0)),
    ((0.5, 0.5, 0.5), 0.9, (0.12, 0.0, 0.0)),
    ((0.05, 0.03, 0.02), 0.4, (0.1, 0.04, 0.0)),
    ((0.2, 0.3, 0.1), 0.7, (0.06, 0.08, 0.0)),
    ((0.02, 0.02, 0.02), 0.3, (0.1, 0.07, 0.0)),
)


def of_one_camera(material):
    diffuse, roughness, offset = material
    setup = a_setup(offset=offset, intensity=3.0 / max(diffuse))
    setup = replace(setup, vignetting=TRUE[0], vignetting_quartic=TRUE[1])
    photo = photograph(setup, diffuse=diffuse, roughness=roughness, noise=0.02)
    pixels = ToneCurve(1.13, SHOULDER).developed(photo.pixels)
    return replace(photo, pixels=pixels, radiometric=False)


@pytest.fixture(scope="module")
def photos():
    return [of_one_camera(material) for material in MATERIALS]


@pytest.fixture(scope="module")
def fits(photos):
    return [fit_coarse(photo) for photo in photos]


def evidence(mean, deviation):
    """Of a photograph that tells each coefficient within a deviation."""
    precision = deviation**-2
    return FalloffLikelihood(
        (mean[0] * precision, mean[1] * precision), (precision, 0.0, precision)
    )


def lost(falloff):
    """Logarithm of what the corners lose, and its deviation."""
    ones = np.ones(2)
    return sum(falloff.mean), math.sqrt(ones @ falloff.covariance @ ones)


def test_photographs_of_different_materials_tell_the_falloff_of_their_camera(fits):
    found = camera_profile("phone", fits)
    assert found.photographs == len(MATERIALS)
    mean, deviation = lost(found.falloff)
    assert abs(mean - sum(TRUE)) < 2.0 * deviation
    # Nearer and surer than before: the prior is off by 0.9.
    assert abs(mean - sum(TRUE)) < 0.3 and deviation < 0.3


def test_a_capture_under_the_profile_finds_falloff_and_gloss_better(photos, fits):
    """The glossy one, which is none of those that told."""
    profile = camera_profile("phone", fits[:-1])
    alone, known = fits[-1], fit_coarse(replace(photos[-1], profile=profile))

    def off(fit):
        return abs(fit.setup.vignetting + fit.setup.vignetting_quartic - sum(TRUE))

    assert off(known) < 0.7 * off(alone)
    assert abs(known.roughness - 0.3) < abs(alone.roughness - 0.3) + 0.01


def test_the_order_of_photographs_does_not_matter(fits):
    assert camera_profile("phone", fits) == camera_profile("phone", fits[::-1])


def test_one_photograph_leaves_the_prior_as_it_is(fits):
    seen = fits[0].falloff
    assert shared_falloff([seen]) == Falloff()
    assert camera_profile("phone", fits[:1]) is None


def test_what_says_little_counts_little_and_what_contradicts_less():
    agreed = [evidence(TRUE, 0.3)] * 8
    plain = lost(shared_falloff(agreed))[0]
    assert plain == pytest.approx(sum(TRUE), abs=0.1)
    glossy = shared_falloff([*agreed, evidence((4.0, 4.0), 5.0)])
    assert lost(glossy)[0] == pytest.approx(plain, abs=0.05)
    wrong = shared_falloff([*agreed, evidence((-3.0, -3.0), 0.3)])
    assert lost(wrong)[0] == pytest.approx(plain, abs=0.15)


def test_photographs_that_scatter_are_told_to_scatter():
    rng = np.random.default_rng(3)
    apart = [evidence(TRUE + rng.normal(0.0, 0.4, 2), 0.1) for _ in range(30)]
    found = shared_falloff(apart)
    assert found.deviation == pytest.approx((0.4, 0.4), rel=0.4)
    assert shared_falloff([evidence(TRUE, 0.1)] * 30).deviation[0] < 0.1


def test_a_profile_gains_no_light_in_the_corners():
    found = shared_falloff([evidence((-0.5, 1.5), 0.2)] * 10)
    assert found.mean[0] == 0.0 and found.mean[1] > 1.0


def test_a_narrow_profile_is_kept(photos):
    narrow = CameraProfile("phone", Falloff((0.2, 0.2), (0.01, 0.01)), 9)
    setup = fit_coarse(replace(photos[0], profile=narrow)).setup
    assert (setup.vignetting, setup.vignetting_quartic) == pytest.approx((0.2, 0.2), abs=0.05)


def test_of_two_coefficients_that_are_known_together_the_sum_holds_and_each_is_free(photos):
    joint = CameraProfile("phone", Falloff((1.5, 0.2), (1.0, 1.0), -0.999), 9)
    setup = fit_coarse(replace(photos[0], profile=joint)).setup
    assert setup.vignetting + setup.vignetting_quartic == pytest.approx(sum(TRUE), abs=0.1)
    assert setup.vignetting < 1.35
