"""The grids of the levels: how coarse each is, and where places may lie."""

from __future__ import annotations

from dataclasses import dataclass

from matcap.example.features import FeatureMap, halved, smoothed

MOST_LEVELS = 5  # periods are multiples of 2^4 texels, as the decoder's
PRICE_BITS = 2  # prices are of squares of so many bits of texels
_MARGIN = 3  # steps between a place and the exemplar's border: beyond, there is no neighbourhood
_ROOM = 8  # steps of the coarsest level that an exemplar is at least wide


@dataclass(frozen=True)
class Frame:
    """Where places may lie, in the exemplar's texels, ends included."""

    left: int
    top: int
    right: int
    bottom: int


def frame_of(level: int, width: int, height: int) -> Frame:
    """Where places of a level may lie."""
    margin = _MARGIN << level
    return Frame(margin, margin, width - 1 - margin, height - 1 - margin)


def level_count(width: int, height: int) -> int:
    """How many levels an exemplar of this size has room for; 0 for too small a one."""
    count = 0
    while count < MOST_LEVELS and min(width, height) >= (_ROOM + 2 * _MARGIN) << count:
        count += 1
    return count


def grid_bits(level: int) -> int:
    """The grid of a level's appearance is half its spacing wide: 2^bits texels."""
    return max(0, level - 1)


def similar_bits(level: int) -> int:
    """The grid of a level's similar places is its spacing wide, and two texels at least."""
    return max(1, level)


def step_of(level: int) -> int:
    """Steps of the appearance's grid between places of a level."""
    return 2 if level else 1


def grids_of(features: FeatureMap, count: int) -> list[FeatureMap]:
    """Per level: the features, smoothed to its spacing."""
    grids = [features]
    for _ in range(1, count):
        grids.append(smoothed(features))
        features = halved(features)
    return grids
