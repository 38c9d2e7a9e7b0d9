"""Presets: what each spends, and what settings make of it."""

import pytest

from matcap.capture.settings import PRESETS, CaptureSettings, Method, resolve
from matcap.errors import UsageError


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_is_its_effort_unless_steps_are_given(preset):
    effort = resolve(CaptureSettings(preset=preset, generator="decoder"))
    assert effort is PRESETS[preset] and effort.preset == preset
    fewer = resolve(CaptureSettings(preset=preset, steps=7))
    assert (fewer.steps, fewer.places) == (7, effort.places)
    assert fewer.adapted == min(7, effort.adapted)


@pytest.mark.parametrize("preset", PRESETS)
def test_a_decoder_beside_the_exemplar_is_tuned_for_less_long(preset):
    beside = resolve(CaptureSettings(preset=preset))
    alone = resolve(CaptureSettings(preset=preset, generator="decoder"))
    assert beside.adapted == alone.adapted
    assert beside.steps == alone.beside <= alone.steps
    assert beside.steps > 0 or preset in ("instant", "draft")


@pytest.mark.parametrize("limit", [{"time_limit": 20.0}, {"target": 1.3}])
def test_a_limit_alone_may_take_all_the_steps_there_are(limit):
    limited = resolve(CaptureSettings(preset="draft", **limit))
    assert (limited.preset, limited.steps) == ("reference", PRESETS["reference"].steps)
    whose = "reference" if "time_limit" in limit else "draft"
    assert limited.adapted == PRESETS[whose].adapted
    assert resolve(CaptureSettings(preset="draft", steps=7, **limit)).steps == 7


def test_a_method_has_the_last_word():
    effort = resolve(CaptureSettings(preset="draft"), Method(places=5, matched=True))
    assert (effort.steps, effort.places, effort.matched) == (PRESETS["draft"].beside, 5, True)


def test_presets_cost_more_and_more():
    costs = [effort.steps * effort.places for effort in PRESETS.values()]
    assert costs == sorted(set(costs))


def test_an_unknown_preset_is_a_usage_error():
    with pytest.raises(UsageError, match="'fast'.*instant, draft"):
        resolve(CaptureSettings(preset="fast"))
