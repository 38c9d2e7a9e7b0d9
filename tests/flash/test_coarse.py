"""The coarse fit and its highlight."""

import math
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
import torch
from uniform import a_setup, photograph

from matcap.flash.coarse.fit import fit_coarse
from matcap.flash.coarse.problem import TiltPrior, priors
from matcap.flash.highlight import elongation, find_highlight, light_of
from matcap.photo.photo import SHOULDER, Photo, ToneCurve

# The coarse fit finds what a uniform photograph was made of.
#
# Stated tolerances, on RAW: hue 2 %, brightness 5 %, F0 beside albedo 30 %, roughness 0.05, the
# flash's offset 0.05 of half the long side, tilt 1.5 degrees. (A broad highlight
# hides a tilt behind an offset, which the priors then split: only glossy ones are tilted here.)


CASES = {
    "satin": dict(roughness=0.4),
    "matt": dict(roughness=0.75, diffuse=(0.2, 0.4, 0.3)),
    "glossy, tilted": dict(roughness=0.25, tilt=(0.06, -0.04)),
    "dark": dict(diffuse=(0.05, 0.04, 0.03), intensity=20.0, offset=(-0.08, 0.1, 0.0)),
    "noisy": dict(noise=0.03),
}


def made(*, offset=(0.1, 0.05, 0.0), tilt=(0.0, 0.0), intensity=10.0, **material):
    setup = a_setup(offset=offset, tilt=tilt, intensity=intensity)
    return setup, photograph(setup, **material)


@cache
def fit_of(**case):
    """The fit of what is made so, once for the tests that compare with it."""
    return fit_coarse(made(**case)[1])


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_a_uniform_material_is_recovered(case):
    setup, fit = made(**case)[0], fit_of(**case)
    diffuse = np.array(case.get("diffuse", (0.3, 0.25, 0.2)))
    found = np.array(fit.diffuse)
    assert found / found.sum() == pytest.approx(diffuse / diffuse.sum(), rel=0.02)
    # One photograph knows albedo times flash, not each.
    brightness = diffuse * setup.intensity[0]
    assert found * fit.setup.intensity[0] == pytest.approx(brightness, rel=0.05)
    expected = case.get("specular", 0.04) / diffuse.mean()
    assert fit.specular / found.mean() == pytest.approx(expected, rel=0.3)
    assert fit.roughness == pytest.approx(case.get("roughness", 0.4), abs=0.05)
    assert fit.setup.tilt == pytest.approx(case.get("tilt", (0.0, 0.0)), abs=math.radians(1.5))
    offset = case.get("offset", (0.1, 0.05, 0.0))
    assert fit.setup.offset[:2] == pytest.approx(offset[:2], abs=0.05)
    assert fit.residual < 0.02 + case.get("noise", 0.0)


def test_a_clipped_highlight_is_a_lower_bound_and_not_a_plateau():
    setup, photo = made(roughness=0.3, intensity=25.0)
    assert 0.003 < photo.clipped_share < 0.2
    fit = fit_coarse(photo)
    assert fit.roughness == pytest.approx(0.3, abs=0.07)
    bright = np.array(fit.diffuse) * fit.setup.intensity[0]
    assert bright == pytest.approx(np.array((0.3, 0.25, 0.2)) * 25.0, rel=0.08)


def test_matte_stays_matte_though_its_middle_is_clipped():
    """A lobe hidden in what is clipped would explain the rest as well."""
    _, photo = made(diffuse=(0.02, 0.02, 0.02), roughness=0.95, intensity=250.0)
    assert photo.clipped_share > 0.05 and fit_coarse(photo).roughness > 0.8


def test_polish_is_found_where_the_plane_is_clipped_too():
    """The starts that end best at a glance are matte; the sharp one is finished besides."""
    _, photo = made(roughness=0.05, intensity=32.0)
    assert photo.clipped_share > 0.2
    assert fit_coarse(photo).roughness == pytest.approx(0.05, abs=0.05)


def test_the_sharp_highlight_of_laminate_is_no_falloff():
    """A coat over a satin base: one lobe cannot be both, and the highlight is what is seen."""
    above = {"offset": (0.0, 0.1, 0.0), "intensity": 6.0}
    setup, coat = made(diffuse=(0.25, 0.23, 0.2), roughness=0.07, **above)
    base = photograph(setup, diffuse=(0.001,) * 3, specular=0.06, roughness=0.5)
    pixels = np.minimum(coat.pixels + base.pixels, np.float32(1.0))
    both = replace(coat, pixels=pixels, clipped=(pixels >= 1.0).any(2), radiometric=False)
    assert fit_coarse(both).roughness < 0.15


def test_a_channel_that_the_file_cannot_hold_changes_nothing_else():
    """A saturated blue has no green beside the highlight: cut off there, as in a JPEG."""
    _, photo = made(diffuse=(0.01, 0.005, 0.5), roughness=0.2, intensity=6.0)
    cut = replace(photo, pixels=photo.pixels.copy(), radiometric=False)
    cut.pixels[..., 1][photo.pixels[..., 1] < 0.04 * photo.pixels[..., 2]] = 0.0
    assert (cut.pixels[..., 1] == 0.0).mean() > 0.5
    whole, found = fit_coarse(replace(photo, radiometric=False)), fit_coarse(cut)
    assert found.roughness == pytest.approx(whole.roughness, abs=0.03)
    shares = [fit.specular / fit.diffuse[2] for fit in (found, whole)]
    assert shares[0] == pytest.approx(shares[1], rel=0.15)


def test_blue_paint_outside_srgb_has_a_white_highlight():
    """Its green is negative: cut off at 0 beside the highlight, and in it less light than red."""
    setup, photo = made(diffuse=(0.02, 0.02, 0.3), roughness=0.4, intensity=6.0)
    none = photograph(setup, diffuse=(1e-6,) * 3, roughness=0.4).pixels[..., 1]
    pixels = photo.pixels.copy()
    pixels[..., 1] = (none - (pixels[..., 1] - none)).clip(0.0)
    assert (pixels[..., 1] == 0.0).mean() > 0.3
    found = fit_coarse(replace(photo, pixels=pixels, radiometric=False))
    red, green, _ = found.setup.intensity
    # With a positive albedo 1.11, and 0.22.
    assert red / green == pytest.approx(1.0, abs=0.05) and found.residual < 0.06


def test_a_known_tilt_is_held():
    """Though the photograph alone would tell another one."""
    known = (0.13, 0.03)
    _, photo = made(tilt=(0.06, -0.04))
    assert fit_coarse(photo, tilt=known).setup.tilt == pytest.approx(known, abs=1e-3)


def test_half_the_exposure_is_half_the_flash_and_the_same_material():
    full_fit, half_fit = fit_of(roughness=0.4), fit_of(roughness=0.4, intensity=5.0)
    assert half_fit.diffuse == pytest.approx(full_fit.diffuse, rel=0.02)
    assert half_fit.roughness == pytest.approx(full_fit.roughness, abs=0.01)
    ratio = half_fit.setup.intensity[0] / full_fit.setup.intensity[0]
    assert ratio == pytest.approx(0.5, rel=0.02)


def test_a_trend_of_colour_is_not_taken_for_the_light():
    """Redder to the right and otherwise the same: red alone would put the flash 0.2 units off."""
    setup, photo = made()
    height, width = photo.pixels.shape[:2]
    u = (np.arange(width) + 0.5) / width * 2.0 - 1.0
    pixels = photo.pixels.copy()
    pixels[..., 0] *= np.exp(0.3 * u)
    fit = fit_coarse(replace(photo, pixels=pixels.astype(np.float32)))
    assert fit.setup.offset[:2] == pytest.approx(setup.offset[:2], abs=0.06)
    assert fit.setup.tilt == pytest.approx((0.0, 0.0), abs=math.radians(1.5))


def test_a_cone_of_flash_light_is_the_cameras_and_not_the_materials():
    """Photographs lose light with r^4 on top of r^2; albedo and gloss are as without."""
    coned = replace(a_setup(), vignetting=0.4, vignetting_quartic=0.9)
    plain = fit_of(roughness=0.5, radiometric=False)
    cone = fit_coarse(photograph(coned, roughness=0.5, radiometric=False))
    assert cone.setup.vignetting_quartic > plain.setup.vignetting_quartic + 0.45
    assert cone.residual < 0.03 and cone.roughness == pytest.approx(plain.roughness, abs=0.05)
    shares = [fit.specular / fit.diffuse[1] for fit in (cone, plain)]
    assert shares[0] == pytest.approx(shares[1], rel=0.35)


def test_a_cone_that_points_aside_does_not_move_the_flash():
    """The light of a phone is brightest above the middle, by 0.25 in the picture."""
    straight = replace(a_setup(offset=(0.02, 0.06, 0.0)), vignetting=0.4, vignetting_quartic=0.6)
    aside = replace(straight, vignetting_centre=(0.0, 0.25))
    fit = fit_coarse(photograph(aside, roughness=0.7, radiometric=False))
    assert fit.setup.vignetting_centre == pytest.approx((0.0, 0.25), abs=0.08)
    assert fit.setup.offset[:2] == pytest.approx((0.02, 0.06), abs=0.04) and fit.residual < 0.03
    fit = fit_coarse(photograph(straight, roughness=0.7, radiometric=False))
    assert fit.setup.vignetting_centre == pytest.approx((0.0, 0.0), abs=0.05)


def _yellower(by_blue, **material):
    """Cloth under a flash that loses `by_blue` more of blue in the corners, around (0, 0.2)."""
    colour = (-by_blue / 3.0, -by_blue / 3.0, 2.0 * by_blue / 3.0)
    setup = replace(a_setup(), vignetting=0.3, vignetting_quartic=0.4, vignetting_centre=(0.0, 0.2))
    cloth = dict(roughness=0.75, radiometric=False, noise=0.05) | material
    return photograph(replace(setup, vignetting_colour=colour), **cloth)


@pytest.mark.parametrize("by_blue", [0.3, 0.0])
def test_a_flash_is_yellower_off_its_axis_and_the_material_is_not(by_blue):
    """A white LED; around the axis of its cone, which is not the lens's."""
    fit, plain = fit_coarse(_yellower(by_blue)), fit_coarse(_yellower(0.0))
    red, green, blue = fit.setup.vignetting_colour
    # The prior of the flash's own colour takes some.
    assert 0.7 * by_blue - 0.03 < blue - green < by_blue + 0.03 and abs(red - green) < 0.03
    hues = [np.array(each.diffuse) * each.setup.intensity for each in (fit, plain)]
    assert hues[0] / hues[0].sum() == pytest.approx(hues[1] / hues[1].sum(), rel=0.05)


def test_a_material_that_is_bluer_on_one_side_keeps_its_hue():
    photo = _yellower(0.0)
    across = np.linspace(-0.4, 0.4, photo.pixels.shape[1], dtype=np.float32)
    pixels = photo.pixels.copy()
    pixels[..., 2] *= np.exp(across)
    fit = fit_coarse(replace(photo, pixels=pixels))
    assert max(map(abs, fit.setup.vignetting_colour)) < 0.05


def test_the_colour_of_a_flash_is_not_measured_on_saturated_colours():
    """Development changes their hue with their brightness."""
    fit = fit_coarse(_yellower(0.3, diffuse=(0.02, 0.05, 0.4)))
    assert fit.setup.vignetting_colour == (0.0, 0.0, 0.0)


def test_a_faint_highlight_does_not_make_a_surface_whiter_than_white():
    """F0 of dielectrics is 0.04: of a white surface with less, albedo would be 2."""
    white = _even((0.8, 0.75, 0.6), (0.015,) * 3, 0.3)
    for taken in (white, replace(white, radiometric=False)):
        fit = fit_coarse(taken)
        assert fit.specular > 0.03, fit


def test_a_raw_shows_the_cone_as_well():
    """The LED lights a cone in every format: gloss is as without."""
    plain = fit_of(roughness=0.5)
    cone = fit_coarse(photograph(replace(a_setup(), vignetting_quartic=0.6), roughness=0.5))
    lost = cone.setup.vignetting + cone.setup.vignetting_quartic
    assert lost == pytest.approx(0.6, abs=0.2)
    assert cone.roughness == pytest.approx(plain.roughness, abs=0.05)
    assert np.mean(cone.diffuse) == pytest.approx(np.mean(plain.diffuse), rel=0.3)


def _even(diffuse, specular, roughness):
    """A photograph of an even surface under an unknown flash, with a little falloff of the lens."""
    setup = replace(a_setup(offset=(0.05, 0.08, 0.0)), vignetting=0.3)
    f0 = torch.tensor(specular, dtype=torch.float64)[:, None, None]
    return photograph(setup, diffuse=diffuse, specular=f0, roughness=roughness)


def test_a_conductor_is_told_from_a_dielectric():
    steel = fit_coarse(_even((1e-4,) * 3, (0.55, 0.53, 0.5), 0.35))
    assert steel.conductor and 0.3 < steel.specular < 0.8 and max(steel.diffuse) < 0.01
    paint = fit_coarse(_even((0.2, 0.1, 0.05), (0.04,) * 3, 0.35))
    assert not paint.conductor and paint.specular == pytest.approx(0.04, rel=0.2)
    assert paint.roughness == pytest.approx(0.35, abs=0.05)


def test_crushed_shadows_are_no_lack_of_diffuse_light():
    """Black leather is as black beside its highlight as steel, by the lowest codes of a JPEG."""
    f0 = torch.tensor([0.55, 0.53, 0.5], dtype=torch.float64)[:, None, None]
    setup = replace(a_setup(offset=(0.05, 0.08, 0.0)), vignetting=1.5)
    steel = photograph(setup, diffuse=(1e-4,) * 3, specular=f0, roughness=0.2)
    dark = (1.2e-3 / np.median(steel.pixels.max(-1)) * steel.pixels).astype(np.float32)
    for pixels, conductor in ((steel.pixels, True), (dark, False)):
        photo = replace(steel, pixels=pixels, radiometric=False)
        assert fit_coarse(photo).conductor == conductor


def test_what_reflects_blue_best_is_no_conductor():
    assert not fit_coarse(_even((1e-4,) * 3, (0.3, 0.4, 0.55), 0.35)).conductor


def test_a_measured_tilt_moves_the_fit_as_far_as_it_is_certain():
    """A sharp measurement decides, a vague one leaves the picture's own."""
    case = CASES["glossy, tilted"]
    (_, photo), alone = made(**case), fit_of(**case)
    sharp = fit_coarse(photo, tilt_prior=TiltPrior((0.13, 0.03), (1e-4, 1e-4)))
    vague = fit_coarse(photo, tilt_prior=TiltPrior((0.13, 0.03), (10.0, 10.0)))
    assert sharp.setup.tilt == pytest.approx((0.13, 0.03), abs=2e-3)
    assert vague.setup.tilt == pytest.approx(alone.setup.tilt, abs=5e-3)
    for fit in (sharp, vague):
        assert fit.tilt_prior is not None and fit.tilt_prior.mean == (0.13, 0.03)
    assert alone.tilt_prior is None


def test_a_measurement_is_pulled_towards_no_tilt_as_far_as_it_is_uncertain():
    """By tilts of 5 degrees; the fit's own prior of 2.9 had halved tilts."""
    photo = made(radiometric=False)[1]
    far = TiltPrior((0.2, -0.15), (0.087, 0.001))
    mean, deviation = priors(photo, None, far, conductor=False)
    assert mean.tilt.tolist() == pytest.approx([0.1, -0.15], rel=1e-3)
    assert deviation.tilt.tolist() == pytest.approx([0.087 / math.sqrt(2.0), 0.001], rel=1e-3)


def test_the_tone_curve_of_a_phone_is_undone():
    """Its prior holds it near 1.13, as falloff imitates it: stronger curves are undone in part."""
    setup = replace(a_setup(intensity=10.0), vignetting=0.4, vignetting_quartic=0.6)
    light = photograph(setup, roughness=0.4, noise=0.01)
    exponents = []
    for exponent in (1.13, 1.3):
        pixels = ToneCurve(exponent, SHOULDER).developed(light.pixels)
        taken = replace(light, pixels=pixels, radiometric=False)
        tone = fit_coarse(taken).tone
        exponents.append(tone.exponent)
        undone, bent = (
            np.log(picture / light.pixels)[light.pixels < 0.8].std()
            for picture in (taken.linearised(tone).pixels, pixels)
        )
        assert undone < (0.2 if exponent == 1.13 else 0.7) * bent
    assert exponents[1] > exponents[0]


def test_a_raw_has_no_tone_curve():
    """Its numbers are proportional to light."""
    assert fit_of(roughness=0.5).tone == ToneCurve()
    assert fit_of(roughness=0.5, radiometric=False).tone.exponent != 1.0


def test_a_coloured_flash_does_not_colour_a_black_dielectric():
    """A dielectric's highlight has the flash's colour: its albedo is what the rest leaves."""
    hue = (0.8, 1.0, 1.15)
    setup = replace(a_setup(), intensity=tuple(8.0 * channel for channel in hue))
    black = (0.004, 0.004, 0.004)
    fit = fit_coarse(photograph(setup, diffuse=black, roughness=0.35, radiometric=False))
    red, green, blue = fit.setup.intensity
    assert (red / green, blue / green) == pytest.approx((0.8, 1.15), rel=0.06)
    assert fit.diffuse[2] / fit.diffuse[0] == pytest.approx(1.0, abs=0.15)
    raw = fit_coarse(photograph(setup, diffuse=black, roughness=0.35))
    assert raw.setup.intensity[2] / raw.setup.intensity[0] == pytest.approx(1.0, abs=0.01)


def test_the_level_of_albedo_is_surer_where_a_highlight_shows_f0():
    """One photograph measures albedo over F0, which is all that fixes its level."""
    glossy, matte = (fit_of(roughness=r).level_deviation for r in (0.3, 0.95))
    assert 0.0 < glossy < 0.5 and matte > 1.5 * glossy


# Highlights are found where the plane mirrors the flash, and coarse fits keep them.


def polished(*, roughness, intensity=10.0, offset=(0.1, 0.05, 0.0), tilt=(0.0, 0.0), **material):
    setup = a_setup(offset=offset, tilt=tilt, intensity=intensity)
    return photograph(setup, roughness=roughness, size=(256, 192), **material)


def assert_kept(photo, fit):
    """The fit's re-rendering, clipped as the camera clips, has the photograph's highlight."""
    size = photo.pixels.shape[1::-1]
    uniform = {"diffuse": fit.diffuse, "specular": fit.specular, "roughness": fit.roughness}
    again = fit.tone.developed(photograph(fit.setup, size=size, **uniform).pixels)
    again = find_highlight(np.minimum(again, 1.0).mean(axis=2))
    there = find_highlight(light_of(photo.pixels))
    assert there is not None and again is not None and math.dist(there.centre, again.centre) < 0.03
    assert again.width == pytest.approx(there.width, rel=0.2)
    assert again.contrast == pytest.approx(there.contrast, rel=0.2)


@pytest.mark.parametrize("offset", [(0.2, 0.0, 0.0), (-0.1, 0.16, 0.0)])
def test_a_highlight_is_half_way_to_the_flash(offset):
    found = find_highlight(light_of(polished(roughness=0.2, offset=offset).pixels))
    assert found.centre == pytest.approx((offset[0] / 2, offset[1] / 2), abs=0.012)


def test_clipping_does_not_move_it():
    dim = find_highlight(light_of(polished(roughness=0.25, intensity=2.0).pixels))
    bright = find_highlight(light_of(polished(roughness=0.25, intensity=20.0).pixels))
    assert bright.peak < 1.01 < dim.contrast
    assert bright.centre == pytest.approx(dim.centre, abs=0.015) and bright.contrast < dim.contrast


def test_rougher_is_wider():
    photos = (polished(roughness=r, intensity=0.1) for r in (0.2, 0.3, 0.4))
    widths = [find_highlight(light_of(photo.pixels)).width for photo in photos]
    assert widths[0] < 0.85 * widths[1] < 0.72 * widths[2]


def patches(seed, least):
    """(192, 256, 1) bool, blots that cover less the more deviations they are above the mean."""
    noise = np.random.default_rng(seed).standard_normal((192, 256)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 3.0)
    return (smooth > least * smooth.std())[..., None]


def bare_metal(seed, least):
    """Highlights of metal alone, and of patches of it in rust."""
    metal = polished(roughness=0.3, specular=0.5, diffuse=(0.02,) * 3).pixels
    rust = polished(roughness=0.9, diffuse=(0.1, 0.05, 0.02)).pixels
    mixed = np.where(patches(seed, least), metal, rust)
    return find_highlight(light_of(metal)), find_highlight(light_of(mixed))


def test_metal_patches_form_one_highlight():
    """Between rust every patch is as bright as a highlight is, and far smaller than this one."""
    alone, found = bare_metal(0, 0.5)
    assert math.dist(found.centre, alone.centre) < 0.08
    assert found.width == pytest.approx(alone.width, rel=0.2)


def test_a_flake_twice_as_bright_as_others_is_no_highlight():
    alone, found = bare_metal(4, 1.4)
    assert found.width > 0.5 * alone.width  # the flake's is 0.17 of it


def test_pale_leaves_on_dark_ground_have_none():
    """The brightest of them is one of many; seldom do they happen to crowd into a spot."""
    leaf, ground = (polished(roughness=0.9, diffuse=(a,) * 3).pixels for a in (0.5, 0.08))
    strewn = (np.where(patches(seed, 1.4), leaf, ground) for seed in range(16))
    assert sum(find_highlight(light_of(each)) is None for each in strewn) >= 8


def test_matt_and_plaid_have_none():
    assert find_highlight(light_of(polished(roughness=0.9).pixels)) is None
    white = np.kron(np.indices((12, 16)).sum(0) % 2, np.ones((16, 16)))
    assert find_highlight(0.1 + 0.8 * white) is None


@pytest.mark.parametrize("radiometric", [True, False], ids=["raw", "developed"])
def test_a_sharp_clipped_spot_on_black_stone_is_kept(radiometric):
    photo = polished(
        roughness=0.15, diffuse=(0.02,) * 3, intensity=12.0, radiometric=radiometric, noise=0.05
    )
    assert 0.0002 < photo.clipped_share < 0.03
    fit = fit_coarse(photo)
    assert_kept(photo, fit)
    assert fit.roughness < 0.25
    # Of a developed picture the priors say how much is flash beside the lens, how much tilt.
    assert math.dist(fit.setup.offset[:2], (0.1, 0.05)) < (0.05 if radiometric else 0.08)


def test_a_spike_in_a_haze_is_kept():
    spike = polished(roughness=0.16, specular=0.02, diffuse=(0.05,) * 3)
    haze = polished(roughness=0.5, specular=0.04, diffuse=(0.05,) * 3)
    pixels = np.minimum(0.5 * (spike.pixels + haze.pixels), 1.0)
    photo = replace(spike, pixels=pixels, clipped=(pixels >= 1.0).any(axis=2), radiometric=False)
    assert_kept(photo, fit_coarse(photo))


@pytest.mark.parametrize("tilt", [(0.17, 0.05), (-0.1, 0.2)])
def test_a_tilted_plane_is_not_taken_for_a_flash_far_off(tilt):
    setup = fit_coarse(polished(roughness=0.35, tilt=tilt, noise=0.03)).setup
    assert math.dist(setup.offset[:2], (0.1, 0.05)) < 0.03
    assert math.degrees(math.dist(setup.tilt, tilt)) < 1.5


def ellipse(ratio: float, angle: float, width: float) -> np.ndarray:
    """(192, 256) a Gaussian spot on grey, `ratio` times as long as wide."""
    u = (np.arange(256) + 0.5)[None] * 2.0 / 256 - 1.0 - 0.1
    v = (192 - 2.0 * (np.arange(192) + 0.5)[:, None]) / 256 + 0.05
    along = u * math.cos(angle) + v * math.sin(angle)
    aside = -u * math.sin(angle) + v * math.cos(angle)
    return 0.1 + 0.8 * np.exp(-0.5 * ((along / (width * ratio)) ** 2 + (aside / width) ** 2))


@pytest.mark.parametrize("width", [0.015, 0.08, 0.15])
@pytest.mark.parametrize(("ratio", "angle"), [(1.0, 0.0), (1.5, 0.4), (1.5, -1.2), (2.0, 1.5)])
def test_elongation_of_the_highlight_is_length_over_width(
    ratio: float, angle: float, width: float
) -> None:
    light = ellipse(ratio, angle, width)
    highlight = find_highlight(light)
    assert highlight is not None
    # A blur of 0.3 widths makes it a little rounder.
    assert 0.9 * ratio < elongation(light, highlight) < 1.05 * ratio


def test_a_mask_that_leaves_only_what_is_clipped_is_fitted_by_its_bound():
    shown = np.random.default_rng(0).uniform(0.1, 0.5, (128, 128, 3)).astype(np.float32)
    shown[:, :64] = 1.0
    clipped = shown[..., 0] >= 1.0
    photo = Photo(shown, clipped, fov=65.0, radiometric=True, left_out=~clipped)
    fit = fit_coarse(photo)
    assert np.isfinite([*fit.diffuse, fit.specular, fit.roughness]).all()
