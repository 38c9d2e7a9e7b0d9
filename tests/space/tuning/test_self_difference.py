"""The photograph's self-difference, the unit of errors in fine-tuning."""

import math
from dataclasses import replace

from tuning import scene

from matcap.space.tuning.match import self_difference
from matcap.statistics.compare import Weights, distance

SEEN = scene()


def test_the_self_difference_is_that_of_adjacent_windows():
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
