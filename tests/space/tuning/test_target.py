"""The target of fine-tuning, in units of the photograph's self-difference."""

import math
from dataclasses import replace

import pytest
from tuning import scene, tune

from matcap.capture.by_decoder import _target
from matcap.capture.settings import CaptureSettings
from matcap.errors import MatcapError
from matcap.space.tuning.windows import self_difference
from matcap.statistics.compare import Weights, distance

SEEN = scene()


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


def test_a_target_for_a_picture_of_one_window_is_refused():
    asked = CaptureSettings(target=1.3)
    assert _target(asked, 0.5, "photo") == pytest.approx(0.65)
    assert _target(CaptureSettings(), math.nan, "photo") is None
    with pytest.raises(MatcapError, match="too small to be compared with itself"):
        _target(asked, math.nan, "photo")
