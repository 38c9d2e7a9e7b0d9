"""Presets: what each spends, and what settings make of it."""

from dataclasses import replace

import pytest

from matcap.capture.settings import PRESETS, UNLIMITED, CaptureSettings, check_photographs, resolve
from matcap.errors import UsageError


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_is_its_effort_unless_steps_are_given(preset):
    effort = resolve(CaptureSettings(preset=preset, generator="decoder"))
    assert effort is PRESETS[preset] and effort.preset == preset
    assert resolve(CaptureSettings(preset=preset)) == replace(effort, steps=0)
    fewer = resolve(CaptureSettings(preset=preset, steps=7, generator="decoder"))
    assert fewer == replace(effort, steps=7)


def test_a_limit_alone_may_take_all_the_steps_there_are():
    asked = {"preset": "draft", "generator": "decoder", "time_limit": 20.0}
    assert resolve(CaptureSettings(**asked)).steps == UNLIMITED.steps > PRESETS["standard"].steps
    assert resolve(CaptureSettings(**asked, steps=7)).steps == 7


@pytest.mark.parametrize(
    ("asked", "wanted"),
    [
        ({}, 2048),
        ({"preset": "instant"}, 512),
        ({"preset": "instant", "generator": "decoder"}, 1024),
        ({"preset": "draft"}, 1024),
        ({"preset": "draft", "generator": "decoder"}, 1024),
        ({"time_limit": 8.0}, 512),
        ({"time_limit": 20.0}, 1024),
        ({"time_limit": 90.0}, 2048),
        ({"detail": 640}, 640),
        ({"preset": "instant", "detail": 4000}, 4000),
    ],
)
def test_the_piece_has_the_finest_texels_where_there_is_time_for_them(asked, wanted):
    settings = CaptureSettings(**asked)
    assert settings.most_detail == settings.detail_of(4032) == wanted
    # A photograph of fewer pixels is enlarged only where that was asked for.
    assert settings.detail_of(1600) == (settings.detail or min(wanted, 1024))


@pytest.mark.parametrize(
    ("option", "asked"),
    [
        ("--steps", {"steps": 7}),
        ("--prior", {"prior": "none"}),
        ("--prior", {"prior": "/nonexistent"}),
        ("--statistics", {"statistics": "vgg19=/nonexistent"}),
        ("--no-drawing", {"drawing": False}),
    ],
)
def test_settings_that_only_a_decoder_uses_are_refused_without_it(option, asked):
    with pytest.raises(UsageError, match=f"{option}: only .*--generator decoder"):
        resolve(CaptureSettings.of(asked))
    resolve(CaptureSettings.of({**asked, "generator": "decoder"}))


def test_presets_cost_more_and_more():
    for costs in (
        [effort.steps * effort.places for effort in PRESETS.values()],
        [effort.detail for effort in PRESETS.values()],
    ):
        assert costs == sorted(set(costs))


def test_a_photograph_of_fewer_pixels_has_the_most_that_it_fills():
    standard = CaptureSettings()
    assert [standard.detail_of(pixels) for pixels in (800, 2000, 4032)] == [1024, 1024, 2048]


@pytest.mark.parametrize("name", ["fast", "high", "reference"])
def test_an_unknown_preset_is_a_usage_error_that_names_the_presets(name):
    with pytest.raises(UsageError, match=f"'{name}'.*instant, draft, standard"):
        resolve(CaptureSettings(preset=name))


def test_a_decoder_of_several_photographs_is_refused():
    with pytest.raises(UsageError, match="fine-tuned to one photograph"):
        check_photographs(CaptureSettings(generator="decoder"), 2)
