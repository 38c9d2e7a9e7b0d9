"""Verdicts: of measures that are made up, of pictures that are, and of captures."""

import math
from dataclasses import replace

import numpy as np
import pytest
import simulated_shots as shots

from matcap.capture.pipeline import capture_photo
from matcap.capture.settings import CaptureSettings
from matcap.capture.verdict.checks import MARK_LIMITS, all_checks, severity
from matcap.capture.verdict.evidence import Evidence, evidence, smooth_difference
from matcap.capture.verdict.judge import judge
from matcap.capture.verdict.rating import Rating
from matcap.capture.verdict.signs import Signs
from matcap.flash.highlight import Highlight
from matcap.flash.render import render_rectified

SPOT = Highlight((0.0, 0.0), 0.1, 0.9, 0.1)
FINE = Evidence(
    highlights=(SPOT, SPOT),
    flash_ratio=3.0,
    flash_fired=True,
    colour=(0.01, -0.01, 0.02),
    light=0.05,
    likeness=1.0,
    contrast={"fine": (0.1, 0.1), "coarse": (0.05, 0.05)},
    order=(0.5, 0.5),
    unevenness=0.6,
    tilt=2.0,
    offset=0.1,
    clipped=0.001,
    piece={
        "error": 0.05, "slow": 0.04, "diffuse": 0.9, "specular": 0.8, "roughness": 0.7,
        "height": 0.7,
    },
)  # fmt: skip


def named(seen):
    return {check.name: check for check in all_checks(seen)}


@pytest.mark.parametrize("limits", [(0.1, 0.2, 0.6), (-1.5, -1.25, -1.12)])
def test_severity_is_one_two_and_three_at_its_limits_and_grows_between(limits):
    assert [severity(limit, limits) for limit in limits] == pytest.approx([1.0, 2.0, 3.0])
    found = [severity(value, limits) for value in np.linspace(limits[0] - 0.1, limits[2] + 1, 50)]
    assert all(a <= b for a, b in zip(found, found[1:], strict=False)) and found[-1] > 3.0


def test_what_is_not_known_is_not_held_against_a_capture():
    assert severity(math.nan, (1.0, 2.0, 3.0)) == 0.0


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
    ({"highlights": (SPOT, None)}, "highlight", "failed"),
    ({"highlights": (SPOT, replace(SPOT, centre=(0.3, 0.0)))}, "highlight", "failed"),
    ({"highlights": (SPOT, replace(SPOT, width=0.5))}, "highlight", "failed"),
    ({"highlights": (SPOT, replace(SPOT, peak=0.2))}, "highlight", "failed"),
    ({"highlights": (None, SPOT)}, "highlight", "failed"),
    ({"flash_ratio": 1.05}, "flash", "failed"),
    ({"flash_ratio": 1.2, "flash_fired": False}, "flash", "failed"),
    ({"light": 0.5}, "light", "failed"),
    ({"colour": (0.2, 0.0, -0.25)}, "colour", "doubtful"),
    ({"likeness": 2.0}, "texture", "doubtful"),
    ({"contrast": {"fine": (0.1, 0.1), "coarse": (0.0, 0.05)}}, "contrast", "failed"),
    ({"order": (0.5, 0.05)}, "order", "failed"),
    ({"unevenness": 4.0}, "sameness", "doubtful"),
    ({"tilt": 20.0}, "camera", "doubtful"),
    ({"offset": 0.5}, "camera", "doubtful"),
    ({"clipped": 0.2}, "clipping", "doubtful"),
    ({"piece": {**FINE.piece, "error": 0.3}}, "piece", "doubtful"),
    ({"marks": dict.fromkeys(MARK_LIMITS, 0.0) | {"roughness": 0.07}}, "marks", "doubtful"),
    ({"piece": {"error": 0.05, "slow": 0.0, "diffuse": 0.1, "height": 0.01}}, "seen", "failed"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "check", "word"), BAD)
def test_one_fault_is_enough_and_is_told_with_remedy(change, check, word):
    seen = replace(FINE, **change)
    verdict = judge(seen)
    assert verdict.rating.value == word and not verdict.fit
    worst = verdict.faults[0]
    assert worst.name == check and worst.remedy
    sentence = verdict.sentence()
    assert sentence.startswith(f"{word}: ") and worst.says in sentence and worst.remedy in sentence


# A sign, what it is called, and the fault that it explains.
SHOWN = [
    ({"streak": 2.0}, "anisotropic highlight", {"highlights": (SPOT, replace(SPOT, width=0.5))}),
    ({"side": 0.05}, "no flash", {"light": 0.5}),
    ({"side": 0.2}, "light from a side", {"light": 0.5}),
    ({"room": 0.5}, "room light", {"light": 0.5}),
    ({"curve": 0.3, "developed": True}, "tone curve", {"colour": (0.2, 0.0, -0.25)}),
    ({"channels": 0.2}, "clipping by channel", {"clipped": 0.2}),
    ({"tilt": 35.0}, "steep relief", {"likeness": 2.0}),
    ({"variety": 0.1}, "large drawing", {"order": (0.5, 0.05)}),
]


@pytest.mark.parametrize(("sign", "name", "fault"), SHOWN)
def test_a_cause_is_named_on_evidence_of_its_own_and_with_what_helps(sign, name, fault):
    verdict = judge(replace(FINE, **fault, signs=Signs(**sign)))
    (cause,) = verdict.causes
    assert cause.name == name
    assert f"Likely cause: {cause.says}. Remedy: {cause.remedy}." in verdict.sentence()
    assert judge(replace(FINE, **fault)).causes == ()


def test_a_flash_that_fired_is_not_said_to_be_missing():
    """Wide beams, photographs of several cameras: an even picture alone is no evidence then."""
    even = replace(FINE, light=0.5, signs=Signs(side=0.05, fired=True))
    assert judge(even).causes == ()


def test_where_the_photograph_shows_no_cause_none_is_told():
    sentence = judge(replace(FINE, light=0.5)).sentence()
    assert "shows no cause" in sentence and "room" not in sentence and "curve" not in sentence


def test_a_cause_that_explains_another_fault_is_not_told_of_this_one():
    verdict = judge(replace(FINE, order=(0.5, 0.05), signs=Signs(room=0.9)))
    assert "period" in verdict.sentence() and "dark parts" not in verdict.sentence()


def test_a_curve_bends_no_raw():
    assert judge(replace(FINE, signs=Signs(curve=0.5))).causes == ()


def test_several_small_faults_make_a_larger_one_but_not_a_failure():
    seen = replace(FINE, light=0.21, likeness=1.45, order=(0.5, 0.26))
    assert all(check.severity < 2.0 for check in all_checks(seen))
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
    return evidence(photo, shots.shot("leather").setup, picture, rendering)


@pytest.fixture(scope="module")
def leather():
    """A good photograph, its true setup, and its plane under that setup."""
    photo, setup = shots.good("leather"), shots.shot("leather").setup
    return photo, setup, render_rectified(shots.maps("leather"), setup)


def test_another_piece_of_the_same_material_under_the_same_flash_is_good(leather):
    photo, setup, seen = leather
    again = render_rectified(shots.maps("leather", seed=4), setup)
    assert judge(_seen(photo, seen, again)).fit


def test_the_light_at_a_wrong_place_is_no_good(leather):
    photo, setup, seen = leather
    moved = replace(setup, offset=(0.7, -0.4, 0.0))
    again = render_rectified(shots.maps("leather", seed=4), moved)
    verdict = judge(_seen(photo, seen, again))
    assert not verdict.fit
    assert {"highlight", "light"} & {fault.name for fault in verdict.faults}


def test_another_material_is_no_good(leather):
    photo, setup, seen = leather
    verdict = judge(_seen(photo, seen, render_rectified(shots.maps("cloth"), setup)))
    assert not verdict.fit


def captured(photo):
    settings = CaptureSettings(preset="instant", detail=512)
    return capture_photo(photo, settings).verdict


def test_a_good_photograph_is_not_called_failed_and_shows_no_cause():
    verdict = captured(shots.good("leather"))
    assert verdict.rating is not Rating.FAILED
    assert verdict.causes == ()


ONE_FAULT = {
    "anisotropic highlight": lambda: shots.with_streak("plaster"),
    "light from a side": lambda: shots.with_lamp("plaster", 2.0),
    "room light": lambda: shots.in_a_lit_room("plaster"),
    "clipping by channel": lambda: shots.too_red("leather"),
}


@pytest.mark.parametrize("fault", ONE_FAULT)
def test_a_photograph_with_one_fault_shows_it(fault):
    assert captured(ONE_FAULT[fault]()).causes[0].name == fault


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


BAD_SHOTS = {
    "no flash": lambda: shots.without_flash("leather"),
    "lamp": lambda: shots.with_lamp("leather"),
    "painting": shots.painting,
}


@pytest.mark.parametrize("bad", BAD_SHOTS)
def test_bad_photographs_are_not_called_good_or_usable(bad):
    assert not captured(BAD_SHOTS[bad]()).fit


def test_a_faint_highlight_that_is_lost_is_missed_and_a_strong_one_is_another_material():
    def severity_of(contrast):
        before = replace(SPOT, peak=contrast * SPOT.surroundings)
        return named(replace(FINE, highlights=(before, None)))["highlight"].severity

    assert 1.0 < severity_of(2.1) < 2.0
    assert severity_of(6.0) > 3.0


def test_a_highlight_just_plain_beside_one_just_not_is_the_same_highlight():
    """Contrast 1.99 beside 2.01 is nothing; beside 4 it is a highlight that was not there."""
    faint = replace(SPOT, peak=1.99 * SPOT.surroundings)

    def check(contrast):
        after = replace(SPOT, peak=contrast * SPOT.surroundings)
        return named(replace(FINE, highlights=(faint, after)))["highlight"]

    assert check(2.01).severity < 0.1
    assert check(2.3).severity < check(2.6).severity < check(3.2).severity
    assert check(4.0).severity > 3.0
    assert "that the photograph has not" in check(4.0).says


def test_a_set_is_not_told_to_be_one():
    def remedy(photographs):
        seen = replace(FINE, light=0.5, signs=Signs(photographs=photographs))
        return judge(seen).sentence().partition("Remedy: ")[2]

    assert "take five photographs" in remedy(1)
    assert "from other sides to these 3" in remedy(3)
    assert "moved further" in remedy(5) and "--together" not in remedy(5)
