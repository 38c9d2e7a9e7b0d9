"""Heights that join where a rearrangement has seams.

Two pieces of an exemplar that look alike lie at different heights, and a step between them would
show and cast a shadow. So the height is looked up in bands, and each band is blended over as many
texels as its waves are long (after Burt and Adelson 1983, on the grid of the output):

    h = b0 + T0 (b1 + T1 (b2 + ... )),

b_k looked up, T_k a filter of 1/4, 1/2, 1/4 along both axes, its taps 2^k texels apart.

Bands are chosen so that where nothing was rearranged h is the exemplar's height. All in integers:
sums are exact, and a texel is the same whatever rectangle it is part of.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Heights = NDArray[np.int32]

BANDS = 5
REACH = 2 ** (BANDS - 1) - 1  # texels that a height reads around itself
FRACTION = 6  # bits of a height unit: roundings of the filters stay below it


def bands_of(codes: NDArray[np.integer]) -> Heights:
    """(BANDS, H, W) of heights (H, W) in units, at most 2^17: in 2^-FRACTION of a unit."""
    rest = codes.astype(np.int32) << FRACTION
    found = [rest]
    for count in range(BANDS - 1, 0, -1):
        low = rest
        for k in range(count):
            low = _filtered(np.pad(low, 1 << k, mode="reflect"), k)
        rest = rest - low
        found.append(rest)
    # What the last filter left of each band is the next finer one.
    return np.stack([found[k] for k in range(BANDS - 1, -1, -1)])


def joined(bands: Heights) -> Heights:
    """(H - 2 REACH, W - 2 REACH) heights of looked-up bands (BANDS, H, W)."""
    height = bands[-1]
    cut = 0
    for k in reversed(range(BANDS - 1)):
        height = _filtered(height, k)
        cut += 1 << k
        rows, columns = bands.shape[1:]
        height += bands[k, cut : rows - cut, cut : columns - cut]
    return height


def _filtered(height: Heights, k: int) -> Heights:
    """A filter of 1/4, 1/2, 1/4 along both axes, 2^k texels apart; smaller by 2^k all around."""
    step = 1 << k
    across = (height[:, : -2 * step] + height[:, 2 * step :] + 2 * height[:, step:-step] + 2) >> 2
    return (across[: -2 * step] + across[2 * step :] + 2 * across[step:-step] + 2) >> 2
