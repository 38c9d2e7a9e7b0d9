"""Verdicts: of measures that are made up, of pictures that are, and of captures."""

import math
import textwrap
from dataclasses import replace
from itertools import product

import cv2
import numpy as np
import pytest
import simulated_shots as shots
from arrays import photo_from_array

from matcap.capture.bracket import MERGED
from matcap.capture.inspection import photograph_quality
from matcap.capture.pipeline import capture_photo
from matcap.capture.rectified import code_step
from matcap.capture.settings import CaptureSettings
from matcap.capture.verdict.causes import ExemplarMeasurements, HighlightProfile, highlight_profile
from matcap.capture.verdict.judge import findings, judge
from matcap.capture.verdict.measurements import (
    Measurements,
    measure_capture,
    patchiness,
    smooth_difference,
    texture_contrasts,
    tile_contrasts,
    uneven_spots,
)
from matcap.flash.highlight import Highlight
from matcap.flash.light import render_rectified
from matcap.flash.rectify import rectify
from matcap.photo.checks import CAUSES, CHECKS, Rating
from matcap.photo.inspect import Inspection, inspect_photo

pytestmark = pytest.mark.usefixtures("one_coarse_fit")
SPOT = Highlight((0.0, 0.0), 0.1, 0.9, 0.1)
GOOD_SHOT = Inspection(
    "made up",
    (
        CHECKS["subject"].rated(True, Rating.GOOD),
        CHECKS["flash"].finding(3.0, fired=""),
        CHECKS["clipped"].finding(0.001),
        CHECKS["tilt"].finding(2.0, side="", raised="left"),
        CHECKS["stationarity"].finding(0.6, where="in the middle"),
        CHECKS["flash_offset"].finding(0.1, off=5.0),
    ),
)


def shot_with(key, value, **words):
    """A good photograph but for one measurement."""
    words = {"fired": "", "side": "", "raised": "left", "where": "here", "off": 9.0} | words
    return {"photograph": GOOD_SHOT.with_finding(CHECKS[key].finding(value, **words))}


def profile(photographed, rerendered, clipped=0.0, glints=((0.05, 0.05),)):
    """Of highlights so many times as bright as a matte surface."""
    return HighlightProfile(((photographed, rerendered), (1.0, 1.0)), (clipped, 0.0), glints)


FINE = Measurements(
    photograph=GOOD_SHOT,
    highlights=(SPOT, SPOT),
    profile=profile(5.0, 5.2),
    colour=(0.01, -0.01, 0.02),
    light=0.05,
    texture=1.0,
    contrast={"fine": (0.1, 0.1), "coarse": (0.05, 0.05)},
    order=(0.5, 0.5),
    exemplar=ExemplarMeasurements(
        error=0.05,
        confidence={"diffuse": 0.9, "specular": 0.8, "roughness": 0.7, "height": 0.7},
        repeats=3.0,
    ),
)


def exemplar_with(**changes):
    """A good exemplar but for these measurements."""
    return {"exemplar": replace(FINE.exemplar, **changes)}


def named(seen):
    return {found.name: found for found in findings(seen)}


RATED = {key: check for key, check in CHECKS.items() if len(check.limits) == 3}


@pytest.mark.parametrize("check", RATED.values(), ids=RATED)
def test_severity_is_one_two_and_three_at_the_limits_and_grows_between(check):
    assert [check.severity(limit) for limit in check.limits] == pytest.approx([1.0, 2.0, 3.0])
    first, _, third = check.limits
    found = [check.severity(x) for x in np.linspace(first, third + 0.5 * (third - first), 50)]
    assert all(a < b for a, b in zip(found, found[1:], strict=False)) and found[-1] > 3.0


@pytest.mark.parametrize("check", [c for c in RATED.values() if c.factor], ids=lambda c: c.key)
def test_a_factor_counts_alike_above_and_below_one(check):
    assert check.severity(1.0) == 0.0 and check.severity(0.4) == pytest.approx(check.severity(2.5))


def test_every_row_of_the_table_is_said_of_something(leather):
    """A row that needs words which nobody gives could not be said."""
    said = [*findings(FINE), *photograph_quality(leather[0]).findings]
    assert set(RATED) <= {found.name for found in said}
    assert all(found.line() and "{" not in found.line() for found in said)


def test_a_person_is_told_of_at_most_twelve_things_by_what_is_seen():
    found = judge(FINE).findings
    seen = [finding.appearance for finding in found]
    assert len(found) <= 12 and len({*seen}) == len(seen)
    assert all(CHECKS[finding.name].seen == finding.appearance for finding in found)
    assert {key for key, check in CHECKS.items() if check.seen} == {one.name for one in found}


@pytest.mark.parametrize("name", ["texture", "contrast", "light", "colour"])
def test_every_difference_has_a_cause_and_what_helps(name):
    worse = {
        "texture": {"texture": 2.5},
        "contrast": {"contrast": {"fine texture": (0.1, 0.3)}},
        "light": {"light": 0.3},
        "colour": {"colour": (0.3, 0.0, 0.0)},
    }
    sentence = judge(replace(FINE, **worse[name])).sentence()
    assert "Why: " in sentence and "What helps: " in sentence and "nknown" not in sentence


def test_why_and_what_helps_are_what_inspect_says():
    shot = shot_with("sharpness", 2.5, details=5.0, width=1024)
    blurred = shot["photograph"]["sharpness"]
    sentence = judge(replace(FINE, texture=2.5, **shot)).sentence()
    assert f"Why: {blurred.says}. What helps: {blurred.remedy}." in sentence
    sharp = shot_with("sharpness", 1.0, details=2.0, width=1024)
    assert "lost at" not in judge(replace(FINE, texture=2.5, **sharp)).sentence()


@pytest.mark.parametrize(
    ("band", "factor", "why"),
    [
        ("fine texture beside the light", 0.5, "lost at"),
        ("coarse texture beside the light", 0.5, "put together"),
        ("coarse texture in the light", 0.5, "shows little of the relief"),
        ("coarse texture in the light", 2.0, "put together"),
        ("coloured texture in the light", 0.5, "put together"),
    ],
)
def test_blur_hides_fine_texture_and_relief_has_no_colour(band, factor, why):
    shot = shot_with("sharpness", 2.5, details=5.0, width=1024)
    worse = {"contrast": {band: (0.1, 0.1 * factor)}, **shot}
    assert why in judge(replace(FINE, **worse)).sentence()


def test_small_differences_are_listed_but_not_what_is_no_difference():
    worse = {"light": 0.11, "colour": (0.055, 0.0, 0.0), "texture": 0.99, "spots": 1.0}
    sentence = judge(replace(FINE, **worse)).sentence()
    assert "several small differences" in sentence and "shading" in sentence
    assert "the texture" not in sentence and "pits" not in sentence


def test_a_clipped_highlight_asks_for_a_darker_photograph():
    quality = photograph_quality(photo_with_clipped_highlight())
    clipped = quality["clipped"]
    assert clipped.rating is Rating.USABLE and quality.rating is not Rating.GOOD
    assert "of its highlight" in clipped.says and "stops darker" in clipped.remedy
    worse = judge(replace(FINE, photograph=quality, colour=(0.3, 0.0, 0.0))).sentence()
    assert f"Why: {clipped.says}. What helps: {clipped.remedy}." in worse
    good = judge(replace(FINE, photograph=quality)).sentence()
    assert good == f"good: looks like the photograph ({clipped.says}: {clipped.remedy})"


def test_of_a_bracket_one_darker_than_its_darkest_is_asked_for():
    photo = photo_with_clipped_highlight()
    merged = replace(photo, notes=(f"{MERGED} other.jpg (2.0 stops darker).",))
    remedy = photograph_quality(merged)["clipped"].remedy
    assert "darker than the darkest" in remedy and "capture all" in remedy
    assert "capture both" in photograph_quality(photo)["clipped"].remedy


def test_where_it_differs_is_marked():
    region = (0.1, 0.2, 0.125, 0.125)
    verdict = judge(replace(FINE, texture=2.5, regions={"texture": region}))
    assert verdict.worst.where == region
    assert verdict.sentence().startswith("doubtful: the texture differs")
    assert "most at the upper left" in verdict.sentence()
    assert verdict.document()["checks"]["texture"]["where"] == [0.1, 0.2, 0.125, 0.125]


def _blank():
    return np.full((300, 400, 3), 0.4, np.float32)


def _evenly_lit():
    noise = cv2.GaussianBlur(np.random.default_rng(1).normal(size=(300, 400)), (0, 0), 2)
    return np.repeat((0.3 + 0.3 * noise)[..., None], 3, 2).clip(0.01, 0.9).astype(np.float32)


def _smooth_paint():
    """Red paint under a flash, in so few codes that most neighbours are equal."""
    y, x = np.mgrid[:600, :800]
    grain = 0.01 * cv2.GaussianBlur(np.random.default_rng(2).normal(size=x.shape), (0, 0), 4) * 14
    red = np.exp(-((x - 400) ** 2 + (y - 300) ** 2) / 2e5) + grain
    codes = np.round(60.0 * red.clip(0.0, 1.0)) / 60.0
    return (codes[..., None] * (1.0, 0.0, 0.0)).astype(np.float32)


def test_smooth_paint_is_no_screenshot():
    pixels = _smooth_paint()
    assert (pixels[:, 1:] == pixels[:, :-1]).all(2).mean() > 0.6
    assert inspect_photo(photo_from_array(pixels))["subject"].rating is Rating.GOOD


def _screen():
    page = np.full((300, 400, 3), 0.8, np.float32)
    page[40:260:20, 30:370:3] = 0.1
    return page


def _object():
    y, x = np.mgrid[:300, :400]
    bright = np.exp(-((x - 200) ** 2 + (y - 150) ** 2) / 2e4)[..., None]
    rough = 1 + 0.3 * np.random.default_rng(0).normal(size=(300, 400, 1)) * (x > 250)[..., None]
    hue = np.where((abs(x - 150) < 70)[..., None], (0.7, 0.2, 0.1), (0.2, 0.3, 0.7))
    return (bright * rough * hue).clip(0.001, 0.95).astype(np.float32)


@pytest.mark.parametrize(
    ("picture", "says"),
    [
        (_blank, "one plain colour"),
        (_evenly_lit, "no flash"),
        (_screen, "exactly as others"),
        (_object, "no flat, even material"),
    ],
)
def test_what_is_no_material_is_named_by_inspect_and_capture_alike(picture, says):
    subject = inspect_photo(photo_from_array(picture()))["subject"]
    assert subject.rating is Rating.FAILED and says in subject.says
    # White paper of a screenshot is clipped, too.
    clipped = CHECKS["clipped"].finding(0.9)
    shot = Inspection("shot", (subject, *GOOD_SHOT.findings[1:])).with_finding(clipped)
    verdict = judge(replace(FINE, photograph=shot))
    assert verdict.rating is Rating.FAILED and says in verdict.sentence()


def test_a_thumbnail_is_named_and_not_rated():
    subject = inspect_photo(photo_from_array(shots.good("tile").pixels[:150, :200]))["subject"]
    assert subject.rating is Rating.NOT_JUDGED and "200 x 150 pixels" in subject.says


def test_what_is_far_overexposed_has_a_flash_that_white_hides():
    found = inspect_photo(replace(photo_from_array(_evenly_lit()), stored_clipped_share=0.5))
    assert found["subject"].rating is Rating.GOOD and found["clipped"].rating is Rating.FAILED


def test_a_band_is_weaker_where_it_is_weakest_beside_the_light():
    seen = 0.2 + 0.05 * np.random.default_rng(3).standard_normal((192, 256, 1), np.float32)
    seen = np.repeat(cv2.GaussianBlur(seen, (0, 0), 1.0)[..., None], 3, 2)
    made = 0.2 + 0.5 * (seen - 0.2)
    made[96:128, 32:64] = 0.2
    made[32:64, 224:] = 0.2 + 3.0 * (seen[32:64, 224:] - 0.2)
    contrast, places = texture_contrasts(seen, (tile_contrasts(seen), tile_contrasts(made)))
    before, after = contrast["fine texture beside the light"]
    assert after < 0.7 * before
    assert places["fine texture beside the light"] == (1 / 8, 3 / 6, 1 / 8, 1 / 6)


def _grain(seed, shape=(192, 256)):
    drawn = np.random.default_rng(seed).standard_normal(shape)
    return cv2.GaussianBlur(drawn, (0, 0), 1.5)[..., None].astype(np.float32)


@pytest.mark.parametrize(("by", "ratio"), [(0.05, 0.6), (8.0, 1.7)])
def test_pits_and_specks_that_few_texels_show_are_seen(by, ratio):
    y, x = np.mgrid[:192, :256]
    light = 0.5 * np.exp(-((x - 128) ** 2 + (y - 96) ** 2) / 8e3)[..., None]
    seen = np.repeat(light * (1.0 + 0.3 * _grain(4)), 3, 2).astype(np.float32)
    made = seen.copy()
    for column in range(100, 124, 6):
        for row in (98, 106, 114):
            made[row : row + 3, column : column + 3] *= by
    whole = np.ones((192, 256), bool)
    found, places = uneven_spots((seen, made), whole)
    assert (found / ratio - 1.0) * (ratio - 1.0) > 0.0
    assert places["spots"] == (3 / 8, 3 / 6, 1 / 8, 1 / 6)
    assert uneven_spots((seen, seen), whole)[0] == 1.0
    assert uneven_spots((seen, made), ~whole) == (1.0, {})


def test_patches_of_other_directions_are_a_quilt_and_a_slow_bend_is_none():
    y, x = np.mgrid[:384, :512].astype(np.float32)
    rough = 0.3 * _grain(6, (384, 512))[..., 0]

    def waves(angle):
        across = np.cos(angle) * x + np.sin(angle) * y
        return np.repeat(np.exp(0.3 * np.sin(across) + rough)[..., None], 3, 2)

    turned = np.random.default_rng(7).uniform(0.0, np.pi, (6, 8)).repeat(64, 0).repeat(64, 1)
    even, bent = patchiness(waves(np.float32(0.5))), patchiness(waves(0.3 + 0.0004 * x))
    assert patchiness(waves(turned.astype(np.float32))) > 2.0 * max(even, bent)


def test_a_fault_that_the_exemplar_has_too_is_not_of_its_rearrangement():
    fault = {"contrast": {"coarse texture beside the light": (0.1, 0.05)}}
    worse, itself = replace(FINE, **fault), replace(FINE, contrast={"coarse": (0.1, 0.1)})
    assert "put together wrongly" in judge(replace(worse, itself=itself)).sentence()
    assert "shows little of the relief" in judge(replace(worse, itself=worse)).sentence()


def test_a_measurement_that_is_not_a_number_has_failed():
    assert judge(replace(FINE, light=math.nan)).rating is Rating.FAILED


def test_the_highlight_of_a_photograph_is_described():
    quality = photograph_quality(shots.good("tile"))
    assert judge(replace(FINE, photograph=quality)).fit
    assert "times as bright as a matte surface" in quality["highlight"].says
    assert "its glints vary by" in quality["highlight"].says


def test_what_is_not_known_is_not_held_against_a_capture():
    unknown = {"texture": math.nan, "order": None, "profile": None}
    seen = replace(FINE, **unknown, highlights=(None, None), exemplar=ExemplarMeasurements())
    assert judge(seen).rating is Rating.GOOD
    ratings = {named(seen)[name].rating for name in ("texture", "pattern", "highlight_contrast")}
    assert ratings == {Rating.NOT_JUDGED}


@pytest.mark.parametrize(
    ("value", "word"),
    [(0.0, "good"), (1.0, "good"), (1.01, "usable"), (2.5, "doubtful"), (9.0, "failed")],
)
def test_the_words_follow_severity(value, word):
    assert Rating.of(value).value == word


def test_a_good_capture_is_called_good_in_a_few_words():
    verdict = judge(FINE)
    assert verdict.rating is Rating.GOOD and verdict.fit
    assert verdict.sentence() == "good: looks like the photograph"


# What is changed, the check that sees it, and the worst word that must not be exceeded upwards.
BAD = [
    ({"profile": profile(5.0, 1.0)}, "highlight_contrast", "failed"),
    ({"profile": profile(1.0, 5.0)}, "highlight_contrast", "failed"),
    ({"profile": profile(5.0, 2.2)}, "highlight_contrast", "doubtful"),
    ({"profile": profile(2.0, 4.4)}, "highlight_contrast", "doubtful"),
    ({"profile": profile(5.0, 5.0, glints=((0.2, 0.08),))}, "highlight_contrast", "doubtful"),
    ({"highlights": (SPOT, None)}, "highlight_contrast", "failed"),
    ({"highlights": (None, SPOT)}, "highlight_contrast", "failed"),
    ({"highlights": (SPOT, replace(SPOT, peak=0.2))}, "highlight_contrast", "failed"),
    ({"highlights": (SPOT, replace(SPOT, width=0.5))}, "highlight_width", "failed"),
    (shot_with("flash", 1.05), "photograph", "failed"),
    ({"light": 0.5}, "light", "failed"),
    ({"colour": (0.2, 0.0, -0.25)}, "colour", "doubtful"),
    ({"texture": 2.5}, "texture", "doubtful"),
    ({"contrast": {"fine": (0.1, 0.1), "coarse": (0.0, 0.05)}}, "contrast", "failed"),
    ({"spots": 2.2}, "spots", "doubtful"),
    ({"spots": 0.45}, "spots", "doubtful"),
    ({"patches": 1.6}, "patches", "doubtful"),
    ({"order": (0.5, 0.05)}, "pattern", "failed"),
    (shot_with("stationarity", 4.0), "photograph", "doubtful"),
    (shot_with("tilt", 20.0), "photograph", "doubtful"),
    (shot_with("flash_offset", 0.5), "photograph", "doubtful"),
    (exemplar_with(repeats=25.0), "repeat", "doubtful"),
    (shot_with("clipped", 0.2), "photograph", "doubtful"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "check", "word"), BAD)
def test_one_fault_is_enough_and_is_told_with_remedy(change, check, word):
    verdict = judge(replace(FINE, **change))
    assert verdict.rating.value == word and not verdict.fit
    worst = verdict.worst
    assert worst.name == check and worst.remedy
    sentence = verdict.sentence()
    assert sentence.startswith(f"{word}: ") and worst.says in sentence and worst.remedy in sentence


# A cause's measurement, and the fault that it explains.
SHOWN = {
    "anisotropic highlight": (2.0, {"highlights": (SPOT, replace(SPOT, width=0.5))}),
    "light from a side": (0.2, {"light": 0.5}),
    "room light": (0.5, {"light": 0.5}),
    "large features": (0.1, {"order": (0.5, 0.05)}),
}


@pytest.mark.parametrize("name", CAUSES)
def test_a_cause_is_named_on_evidence_of_its_own_and_with_what_helps(name):
    value, fault = SHOWN[name]
    verdict = judge(replace(FINE, **fault, causes={name: value}))
    (cause,) = verdict.causes
    assert cause.name == name
    assert f"Why: {cause.says}. What helps: {cause.remedy}." in verdict.sentence()
    assert judge(replace(FINE, **fault)).causes == ()


def test_where_the_photograph_shows_no_cause_none_is_named():
    sentence = judge(replace(FINE, light=0.5)).sentence()
    assert "does not tell colour" in sentence
    assert "room" not in sentence and "curve" not in sentence
    several = judge(replace(FINE, light=0.5, photographs=3)).sentence()
    assert "these photographs do not tell" in several


def test_sentences_fit_four_lines_of_a_terminal():
    """Of every check, at its worst, with the longest reason and remedy."""
    repeats = {"order": (0.5, 0.5), "causes": {"large features": 0.1}}
    for (change, _, _), causes in product(BAD, ({}, repeats)):
        sentence = judge(replace(FINE, **{**causes, **change})).sentence()
        assert len(textwrap.wrap(f"  {sentence}", 80)) <= 4, sentence


def test_a_cause_that_explains_another_fault_is_not_told_of_this_one():
    verdict = judge(replace(FINE, order=(0.5, 0.05), causes={"room light": 0.9}))
    assert "as regular" in verdict.sentence() and "dark parts" not in verdict.sentence()


def test_several_small_faults_make_a_larger_one_but_not_a_failure():
    seen = replace(FINE, light=0.21, texture=1.45, order=(0.5, 0.26))
    assert all(check.severity < 2.0 for check in findings(seen))
    assert judge(seen).rating is Rating.DOUBTFUL


def test_a_lack_of_contrast_that_no_eye_sees_is_none():
    faint = replace(FINE, contrast={"fine": (0.001, 0.003), "coarse": (0.001, 0.001)})
    assert named(faint)["contrast"].rating is Rating.GOOD


def test_the_document_is_json_and_holds_every_check():
    import json

    document = json.loads(json.dumps(judge(FINE).document(), allow_nan=False))
    assert set(document["checks"]) == set(named(FINE)) and document["fit"] is True


def _seen(photo, seen, again):
    """What is measured of a capture."""
    picture = seen.movedim(0, -1).contiguous().numpy()
    rendering = again.movedim(0, -1).contiguous().numpy()
    setup = shots.shot("leather").setup
    return measure_capture(photo, setup, picture, rendering, _valid(photo, setup, picture))


def _valid(photo, setup, picture):
    """(H, W) where the photograph was seen and not clipped, on a picture's grid."""
    return rectify(photo, setup, picture.shape[1])[1].numpy()


@pytest.fixture(scope="module")
def leather():
    """A good photograph, its true setup, and its plane under that setup."""
    photo, setup = shots.good("leather"), shots.shot("leather").setup
    return photo, setup, render_rectified(shots.maps("leather"), setup)


def test_another_piece_of_the_same_material_under_the_same_flash_is_good(leather):
    photo, setup, seen = leather
    assert judge(_seen(photo, seen, render_rectified(shots.maps("leather", seed=4), setup))).fit


def test_the_light_at_a_wrong_place_is_no_good(leather):
    photo, setup, seen = leather
    moved = replace(setup, offset=(0.7, -0.4, 0.0))
    verdict = judge(_seen(photo, seen, render_rectified(shots.maps("leather", seed=4), moved)))
    assert not verdict.fit and verdict.worst.name in {"highlight_contrast", "light", "colour"}


def test_another_material_is_no_good(leather):
    photo, setup, seen = leather
    verdict = judge(_seen(photo, seen, render_rectified(shots.maps("cloth"), setup)))
    assert not verdict.fit


def captured(photo):
    return capture_photo(photo, CaptureSettings(preset="instant", detail=160)).verdict


def test_a_good_photograph_is_not_called_failed_and_shows_no_cause():
    verdict = captured(shots.good("leather"))
    assert verdict.rating is not Rating.FAILED and verdict.causes == ()


ONE_FAULT = {
    "anisotropic highlight": lambda: shots.with_streak("plaster"),
    "light from a side": lambda: shots.with_lamp("plaster", 2.0),
    "room light": lambda: shots.in_a_lit_room("plaster"),
}


@pytest.mark.parametrize("fault", ONE_FAULT)
def test_a_photograph_with_one_fault_shows_it(fault):
    assert captured(ONE_FAULT[fault]()).causes[0].name == fault


def test_a_clipped_colour_is_explained_by_clipping():
    """Exposed so long that red clips, and little else."""
    verdict = captured(shots.too_red("leather"))
    assert not verdict.fit and "is clipped" in verdict.sentence()


def test_another_place_for_veins_is_no_other_light():
    """Smooth as light, as large as the picture, and elsewhere in another piece of the material."""
    x = np.linspace(-1.0, 1.0, 64)[None, :, None]
    y = np.linspace(-0.75, 0.75, 48)[:, None, None]
    light = np.exp(-(x**2 + y**2)) * np.ones((1, 1, 3))
    vein, other = (np.exp(np.cos(15.0 * x + 8.0 * y + phase)) for phase in (0.0, 2.0))
    whole = float(np.log(vein / other).std())
    assert smooth_difference(light * vein, light * other)[1] < 0.25 * whole
    assert smooth_difference(light, light * np.exp(0.5 * x))[1] > 0.2
    assert smooth_difference(light, light**2)[1] > 0.2


def test_a_channel_that_is_hardly_there_has_no_colour_of_its_own():
    """Green of 1 % of a paint's blue, in the re-rendering twice that: a tenth; of a grey, all."""
    paint = np.ones((48, 64, 3)) * (0.03, 0.002, 0.2)
    (_, green, _), _ = smooth_difference(paint, paint * (1.0, 2.0, 1.0))
    assert 0.0 < green < 0.12
    grey = np.ones((48, 64, 3)) * 0.1
    (_, green, _), _ = smooth_difference(grey, grey * (1.0, 2.0, 1.0))
    assert green == pytest.approx(np.log(2.0), abs=0.02)
    mottled = np.full((384, 512, 3), (0.03, 0.002, 0.2), np.float32)
    mottled[..., 1] *= np.exp(0.5 * np.sin(np.arange(512) / 6.0))  # unseen
    assert np.sqrt(tile_contrasts(mottled)["coloured"].max()) < 0.05


BAD_SHOTS = {
    "no flash": lambda: shots.without_flash("leather"),
    "lamp": lambda: shots.with_lamp("leather"),
    "painting": shots.painting,
}


@pytest.mark.parametrize("bad", BAD_SHOTS)
def test_bad_photographs_are_not_called_good_or_usable(bad):
    """However well they are captured."""
    assert not judge(replace(FINE, photograph=photograph_quality(BAD_SHOTS[bad]()))).fit


@pytest.mark.parametrize(("factor", "fit"), [(0.49, False), (0.6, True), (1.7, True), (2.1, False)])
def test_a_highlight_half_or_twice_as_strong_is_not_usable(factor, fit):
    verdict = judge(replace(FINE, profile=profile(4.0, 4.0 * factor)))
    assert verdict.fit is fit
    assert verdict.worst.name == "highlight_contrast" or fit


@pytest.fixture(scope="module")
def glossy():
    """Granite, photographed dark enough that its highlight is not clipped, with its true setup."""
    setup = replace(shots.SETUP, tilt=(0.0, 0.0))
    picture = render_rectified(shots.maps("granite"), setup).movedim(0, -1).contiguous().numpy()
    assert 0.1 < picture.max() < 1.0
    return photo_from_array(picture, fov=setup.fov), setup, picture


def photo_with_clipped_highlight():
    """Granite, exposed so long that its highlight is white."""
    photo = shots.good("granite")
    pixels = photo.pixels / np.quantile(photo.pixels.max(axis=2), 0.99)
    return replace(photo, pixels=pixels.clip(0, 1), clipped=(pixels >= 1.0).any(axis=2))


def rendered_again(setup, **factors):
    """What a capture re-renders that is right but for factors of some maps."""
    maps = shots.maps("granite", seed=4)
    maps = replace(maps, **{name: getattr(maps, name) * by for name, by in factors.items()})
    return render_rectified(maps, setup).movedim(0, -1).contiguous().numpy()


def highlight_of(glossy, **factors):
    """What is measured of such a capture."""
    photo, setup, picture = glossy
    again, valid = rendered_again(setup, **factors), _valid(photo, setup, picture)
    return measure_capture(photo, setup, picture, again, valid)


def test_a_capture_with_the_photographed_gloss_is_usable(glossy):
    seen = highlight_of(glossy)
    assert seen.profile.contrast[0] > 4.0 and not seen.profile.bound
    assert 0.8 < seen.profile.ratio < 1.25 and judge(seen).fit


@pytest.mark.parametrize("factors", [{"specular": 0.25}, {"roughness": 2.0}, {"specular": 4.0}])
def test_a_capture_whose_gloss_is_replaced_is_not_usable(glossy, factors):
    """F0 or roughness such that the highlight is less than half, or over twice, as strong."""
    seen = highlight_of(glossy, **factors)
    assert not 0.5 < seen.profile.ratio < 2.0
    assert not named(seen)["highlight_contrast"].rating.fit and not judge(seen).fit


def test_contrast_is_of_radiance_over_an_even_matte_surface(glossy):
    """F0 adds to the highlight in proportion: L = diffuse + F0 S, where the surround has no S."""
    photo, setup, picture = glossy
    seen = _valid(photo, setup, picture)
    pictures = ((picture, rendered_again(setup, specular=factor)) for factor in (1.0, 0.5))
    once, half = (highlight_profile(each, seen, seen, setup).contrast[1] for each in pictures)
    assert half - 1.0 == pytest.approx(0.5 * (once - 1.0), rel=0.1)


def test_both_pictures_are_clipped_where_the_photograph_is(glossy):
    photo, setup, picture = glossy
    bright = picture / np.quantile(picture, 0.9)
    clipped = replace(photo_from_array(bright.clip(0, 1)), clipped=(bright >= 1.0).any(axis=-1))
    valid = _valid(clipped, setup, bright)
    seen = measure_capture(clipped, setup, bright.clip(0, 1), bright, valid)
    assert seen.profile.bound and seen.profile.ratio == pytest.approx(1.0)
    weaker = measure_capture(clipped, setup, bright.clip(0, 1), 0.2 * bright, valid)
    assert weaker.profile.contrast[1] > 1.3 * weaker.profile.contrast[0]  # that of its true core


def test_a_faint_highlight_that_is_lost_is_missed_and_a_strong_one_is_another_material():
    def severity_of(contrast):
        before = replace(SPOT, peak=contrast * SPOT.surroundings)
        return named(replace(FINE, highlights=(before, None)))["highlight_contrast"].severity

    assert 1.0 < severity_of(2.1) < 2.0 and severity_of(6.0) > 3.0


def test_a_highlight_just_plain_beside_one_just_not_is_the_same_highlight():
    """Contrast 1.99 beside 2.01 is nothing; beside 7 it is a highlight that was not there."""
    faint = replace(SPOT, peak=1.99 * SPOT.surroundings)

    def severity_of(contrast):
        after = replace(SPOT, peak=contrast * SPOT.surroundings)
        seen = replace(FINE, highlights=(faint, after), profile=None)
        return named(seen)["highlight_contrast"].severity

    assert severity_of(2.01) < 0.1 and severity_of(2.3) < severity_of(2.6) < severity_of(3.2)
    assert severity_of(7.0) > 3.0


def test_where_nothing_is_glossy_no_highlight_is_judged():
    matte = replace(FINE, profile=profile(1.1, 0.9, glints=()), highlights=(None, None))
    assert named(matte)["highlight_contrast"].rating is Rating.NOT_JUDGED


def test_beyond_a_clipped_core_the_first_ring_that_is_not_counts():
    rings = (5.0, 5.0), (4.0, 4.0), (3.0, 1.5), (2.0, 0.2), (1.0, 1.0)
    assert HighlightProfile(rings, (0.9, 0.2, 0.0, 0.0, 0.0)).ratio == pytest.approx(0.5)
    assert HighlightProfile(rings, (0.0, 0.0, 0.0, 0.0, 0.0)).ratio == pytest.approx(1.0)


def test_a_matte_surface_has_no_highlight_however_its_light_falls_off():
    setup = replace(shots.SETUP, tilt=(0.0, 0.0), vignetting=0.5)
    picture = render_rectified(shots.maps("plaster"), setup).movedim(0, -1).numpy()
    whole = np.ones(picture.shape[:2], bool)
    found = highlight_profile((picture, 2.0 * picture), whole, whole, setup)
    assert found.contrast == pytest.approx((1.0, 1.0), abs=0.1) and not found.glossy


def test_a_clipped_core_is_told_to_be_a_bound():
    says = named(replace(FINE, profile=profile(5.0, 2.0, clipped=0.4)))["highlight_contrast"].says
    assert "40 % of the photograph's highlight is clipped" in says
    assert "clipped" not in named(FINE)["highlight_contrast"].says


def test_a_usable_capture_is_told_its_largest_difference():
    """Several small ones, none of which is seen by itself, are no photograph's likeness."""
    seen = replace(FINE, light=0.119, texture=1.09, order=(0.5, 0.355), colour=(0.059, 0.0, 0.0))
    verdict = judge(seen)
    assert verdict.rating is Rating.USABLE and max(one.severity for one in findings(seen)) < 1.0
    assert "looks like the photograph" not in verdict.sentence()
    assert verdict.worst.says in verdict.sentence() and "none of them a fault" in verdict.sentence()
    assert "Why" not in verdict.sentence()


def test_a_good_photograph_is_not_what_is_wrong():
    """Small differences add up to a usable capture; a tilt within its limit is none of them."""
    seen = replace(FINE, light=0.119, texture=1.09, order=(0.5, 0.36), **shot_with("tilt", 7.99))
    verdict = judge(seen)
    assert verdict.rating is Rating.USABLE and verdict.worst.name != "photograph"


def test_a_set_is_not_told_to_be_one():
    def remedy(photographs, order=None):
        seen = replace(FINE, light=0.5, photographs=photographs, order=order)
        return judge(seen).sentence().partition("What helps: ")[2]

    assert "capture five photographs" in remedy(1) and "two thirds" not in remedy(1)
    assert "mark in each" in remedy(1, order=(0.9, 0.9)) and "mark" not in remedy(1)
    assert "from other sides to these 3" in remedy(3)
    assert "moved further" in remedy(5) and "--together" not in remedy(5)


def test_a_white_dot_on_black_has_a_highlight_profile():
    black, setup = np.zeros((96, 128, 3), np.float32), shots.SETUP
    dot = black.copy()
    dot[5, 7] = 1.0
    whole = np.ones(black.shape[:2], np.bool_)
    for pictures in ((dot, dot), (dot, black), (black, dot), (black, black + 0.5)):
        found = highlight_profile(pictures, whole, whole, setup)
        assert math.isfinite(found.contrast[0] / found.contrast[1])
        assert math.isnan(found.ratio) or 0.0 < found.ratio < math.inf


def test_colour_within_a_code_is_noise_of_a_developed_photograph() -> None:
    """Blotches of a code beside grey are not missed; those of eight codes are."""
    drawn = np.random.default_rng(2).standard_normal((192, 256, 3)).astype(np.float32)
    blotches = cv2.GaussianBlur(drawn, (0, 0), 4.0)
    blotches /= blotches.std()
    grey = np.full((192, 256, 3), 0.2, np.float32)
    for codes, least, most in ((1.0, 0.6, 1.0), (8.0, 0.0, 0.35)):
        seen = grey + blotches * code_step(grey) * np.float32(codes)
        tiles = tile_contrasts(seen), tile_contrasts(grey)
        contrasts, _ = texture_contrasts(seen, tiles, developed=True)
        before, after = contrasts["coloured texture in the light"]
        assert least < after / before < most
    before, after = texture_contrasts(seen, tiles)[0]["coloured texture in the light"]
    assert after < 1e-3 < before


@pytest.mark.parametrize(("level", "codes", "counts"), [(6e-4, 0.7, False), (0.2, 24.0, True)])
def test_codes_of_black_are_no_texture(level: float, codes: float, counts: bool) -> None:
    """Noise of less than a code is most of the contrast of black; 24 codes of grey are missed."""
    drawn = np.random.default_rng(3).standard_normal((192, 256, 1)).astype(np.float32)
    flat = np.full((192, 256, 3), level, np.float32)
    seen = np.maximum(flat + codes * code_step(flat) * drawn, 0.0).astype(np.float32)
    tiles = tile_contrasts(seen), tile_contrasts(flat)
    before, after = texture_contrasts(seen, tiles, developed=True)[0]["fine texture in the light"]
    assert (after < 0.3 * before) if counts else (after > 0.6 * before)
