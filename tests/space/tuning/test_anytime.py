"""Capture at any time: targets, what more time would buy, and the picture of it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tuning import scene, tune

from matcap.capture.by_decoder import _target
from matcap.capture.settings import CaptureSettings
from matcap.errors import MatcapError
from matcap.space.tuning.anytime import forecast, self_difference
from matcap.space.tuning.curve import draw_history
from matcap.statistics.compare import Weights, distance

SEEN = scene()


def falling(seconds, a=0.8, b=0.2, rate=10):
    """A history whose error is a - b log10(seconds), as such searches go."""
    times = np.arange(1, seconds * rate) / rate
    return [(t, i + 1, a - b * math.log10(t)) for i, t in enumerate(times.tolist())]


def test_the_self_difference_is_what_windows_side_by_side_differ_by():
    """Neither 0, as overlapping ones would have it, nor what unlike textures are apart."""
    own = self_difference(SEEN.windows, Weights())
    assert 0.1 < own < 2.0
    target = SEEN.windows.target
    other = target.select(list(range(SEEN.windows.count))[::-1])
    assert own < 1.5 * float(distance(other, target, Weights(mean=0.0)).mean())


def test_one_window_has_no_self_difference():
    alone = replace(
        SEEN.windows, points=SEEN.windows.points[:1], target=SEEN.windows.target.select([0])
    )
    assert math.isnan(self_difference(alone, Weights()))


def test_tuning_ends_soon_after_its_target_with_a_frozen_end():
    long = tune(steps=60)
    halfway = min(error for _, _, error in long.history[:30])
    short = tune(steps=60, target=halfway)
    reached = next(step for _, step, error in short.history if error <= halfway)
    assert 10 < reached <= 30
    assert reached < len(short.history) <= 1.2 * reached + 2
    assert [p[1:] for p in short.history[:25]] == [p[1:] for p in long.history[:25]]


def test_a_target_out_of_reach_changes_nothing():
    plain, aimed = tune(steps=15), tune(steps=15, target=1e-6)
    assert [p[1:] for p in plain.history] == [p[1:] for p in aimed.history]


def test_more_time_buys_what_the_trend_says():
    history = falling(30)
    expected = 0.8 - 0.2 * math.log10(history[-1][0] + 60.0)
    assert forecast(history, 60.0) == pytest.approx(expected, abs=1e-3)
    assert forecast(history, 0.0) == pytest.approx(history[-1][2])


def test_a_few_low_windows_are_not_taken_for_a_fall():
    """The last half of the time wavers as much as it falls; all of it tells where it goes."""

    def true(seconds):
        return 1.6 - 0.15 * math.log10(seconds)

    times = [0.3 * step for step in range(1, 81)]
    history = [
        (t, i, true(t) - 0.1 * math.cos(2.0 * math.pi * t / times[-1]))
        for i, t in enumerate(times, start=1)
    ]
    assert forecast(history, 60.0) == pytest.approx(true(times[-1] + 60.0), rel=0.12)


def test_more_time_never_makes_it_worse_nor_better_than_perfect():
    rising = [(t, i, 1.0 + t) for t, i, _ in falling(10)]
    assert forecast(rising, 60.0) == rising[-1][2]
    assert forecast(falling(30), 1e9) == 0.0


@pytest.mark.parametrize("history", [[], falling(30)[:10]])
def test_nothing_is_foretold_too_early(history):
    assert forecast(history, 60.0) is None


def test_the_curve_falls_in_the_picture():
    line = np.array([108, 182, 255])
    picture = np.asarray(draw_history(falling(30), 0.1)).astype(int)
    rows = [
        np.flatnonzero((np.abs(picture[60:350, x] - line).sum(axis=1)) < 40).mean()
        for x in (80, 200, 400, 650)
    ]
    assert rows == sorted(rows) and rows[-1] > rows[0] + 30


@pytest.mark.parametrize(
    "history",
    [(), ((0.0, 1, 1.0),), ((0.1, 1, math.inf), (0.2, 2, math.nan)), ((1.0, 1, 0.0),)],
)
def test_any_history_can_be_drawn(history):
    assert draw_history(history, math.nan).size == draw_history(falling(10), 0.3).size


def test_a_target_for_a_picture_of_one_window_is_refused():
    asked = CaptureSettings(target=1.3)
    assert _target(asked, 0.5, "photo") == pytest.approx(0.65)
    assert _target(CaptureSettings(), math.nan, "photo") is None
    with pytest.raises(MatcapError, match="too small to be compared with itself"):
        _target(asked, math.nan, "photo")
