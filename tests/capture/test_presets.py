"""Presets: how many steps each has and how many windows it compares a step."""

import pytest

from matcap.capture.pipeline import PRESETS, CaptureSettings, _effort, _steps


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_is_its_effort_unless_steps_are_given(preset):
    settings = CaptureSettings(preset=preset)
    assert _effort(settings) is PRESETS[preset]
    assert _steps(settings) == PRESETS[preset].steps
    fewer = CaptureSettings(preset=preset, steps=7)
    assert (_steps(fewer), _effort(fewer).places) == (7, PRESETS[preset].places)


@pytest.mark.parametrize("limit", [{"time_limit": 20.0}, {"target": 1.3}])
def test_a_limit_alone_may_take_all_the_steps_there_are(limit):
    assert _effort(CaptureSettings(preset="draft", **limit)) is PRESETS["reference"]
    assert _steps(CaptureSettings(preset="draft", steps=7, **limit)) == 7


def test_presets_cost_more_and_more():
    costs = [effort.steps * effort.places for effort in PRESETS.values()]
    assert costs == sorted(set(costs))
