"""Grids of the synthesis levels, and the frame that places are limited to."""

from __future__ import annotations

from dataclasses import dataclass

from matcap.example.features import FeatureMap, halved, smoothed

MOST_LEVELS = 5  # so that periods are multiples of 2^4 texels, as the decoder's
COST_BITS = 2  # the grid of placement costs has a step of 2^COST_BITS texels
_MARGIN = 3  # steps between places and the exemplar's border, for their neighbourhoods
_LEAST_STEPS = 8  # least width of the coarsest level's frame, in its steps


@dataclass(frozen=True)
class Frame:
    """Rectangle of the exemplar's texels that places are limited to, ends included."""

    left: int
    top: int
    right: int
    bottom: int


def frame_of(level: int, width: int, height: int) -> Frame:
    """The frame of a level's places, for an exemplar of this size."""
    margin = _MARGIN << level
    return Frame(margin, margin, width - 1 - margin, height - 1 - margin)


def level_count(width: int, height: int) -> int:
    """Number of levels for an exemplar of this size; 0 if it is too small."""
    count = 0
    while count < MOST_LEVELS and min(width, height) >= (_LEAST_STEPS + 2 * _MARGIN) << count:
        count += 1
    return count


def grid_bits(level: int) -> int:
    """log2 of the step of a level's appearance grid: half its spacing, at least a texel."""
    return max(0, level - 1)


def similar_bits(level: int) -> int:
    """log2 of the step of a level's candidate grid: its spacing, at least two texels."""
    return max(1, level)


def step_of(level: int) -> int:
    """Steps of a level's appearance grid between its places."""
    return 2 if level else 1


def grids_of(features: FeatureMap, count: int) -> list[FeatureMap]:
    """The features on each level's appearance grid, smoothed to the level's spacing."""
    grids = [features]
    for _ in range(1, count):
        grids.append(smoothed(features))
        features = halved(features)
    return grids
