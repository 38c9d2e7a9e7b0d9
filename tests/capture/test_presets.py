"""Presets: what each spends, and what settings make of it."""

from dataclasses import replace

import pytest

from matcap.capture.method import Method
from matcap.capture.settings import (
    PRESETS,
    UNLIMITED,
    CaptureSettings,
    check_photographs,
    resolve,
)
from matcap.errors import UsageError


@pytest.mark.parametrize("preset", PRESETS)
def test_several_photographs_are_not_adapted(preset):
    settings = CaptureSettings(preset=preset)
    several = resolve(settings, photographs=3)
    assert several.adapted == 0 and several.detail == resolve(settings).detail
    decoder = CaptureSettings(preset=preset, generator="decoder")
    assert resolve(decoder, photographs=3) == resolve(decoder)


def test_steps_of_several_photographs_are_refused_but_in_a_batch_of_single_ones():
    settings = CaptureSettings(steps=7)
    check_photographs(settings, 1)
    check_photographs(replace(settings, generator="decoder"), 3)
    with pytest.raises(UsageError, match="--steps: several photographs are solved"):
        check_photographs(settings, 3)
    assert settings.of_sample(1) is settings
    check_photographs(settings.of_sample(3), 3)


@pytest.mark.parametrize("generator", ["example", "decoder"])
@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_is_its_effort_unless_steps_are_given(preset, generator):
    effort = resolve(CaptureSettings(preset=preset, generator=generator))
    assert effort is PRESETS[preset] and effort.preset == preset
    fewer = resolve(CaptureSettings(preset=preset, steps=7, generator=generator))
    assert (fewer.work(generator), fewer.places) == (7, effort.places)


@pytest.mark.parametrize("limit", [{"time_limit": 20.0}, {"target": 1.3}])
def test_a_limit_alone_may_take_all_the_steps_there_are(limit):
    asked = {"preset": "draft", "generator": "decoder", **limit}
    assert resolve(CaptureSettings(**asked)).steps == UNLIMITED.steps > PRESETS["standard"].steps
    assert resolve(CaptureSettings(**asked, steps=7)).steps == 7


@pytest.mark.parametrize(
    ("asked", "wanted"),
    [
        ({}, 2048),
        ({"preset": "instant"}, 512),
        ({"preset": "instant", "generator": "decoder"}, 1024),
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


def test_a_target_is_the_decoders():
    with pytest.raises(UsageError, match="--generator decoder"):
        resolve(CaptureSettings(target=1.3))


def test_a_method_has_the_last_word():
    effort = resolve(CaptureSettings(preset="draft"), Method(places=5, matched=True, adapted=3))
    assert (effort.adapted, effort.places, effort.matched) == (3, 5, True)


def test_presets_cost_more_and_more():
    for costs in (
        [effort.steps * effort.places for effort in PRESETS.values()],
        [(effort.detail, effort.adapted) for effort in PRESETS.values()],
    ):
        assert costs == sorted(set(costs))


def test_a_photograph_of_fewer_pixels_has_the_most_that_it_fills():
    standard = CaptureSettings()
    assert [standard.detail_of(pixels) for pixels in (800, 2000, 4032)] == [1024, 1024, 2048]


@pytest.mark.parametrize("name", ["fast", "high", "reference"])
def test_an_unknown_preset_is_a_usage_error_that_names_the_presets(name):
    with pytest.raises(UsageError, match=f"'{name}'.*instant, draft, standard"):
        resolve(CaptureSettings(preset=name))
