"""The flash's colour off its axis, from the residuals of the coarse fit.

White LEDs are yellower off the axis of their cone. Of grey materials it shows: log ratios of the
channels are linear in s, the squared distance from the vignetting's centre over that of a corner.
Of 126 photographs those of one phone lose 0.27 more of blue than of green in a corner (grey cloth
and plaster), around the centre that brightness has (residuals of 0.025; around the lens's axis
0.045), those of another 0.03 (docs/notes/gloss.md).

The residuals of what is matte, bright enough and not saturated measure it: development changes the
hue of the others with their brightness. What sectors do not agree on is texture.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.flash.coarse.cells import CoarseCells, Doubles
from matcap.flash.least_squares import huber
from matcap.flash.light import CORNER_SQUARED

_MATTE = 0.7  # least diffuse share of a cell
_GREYEST = 0.25  # least ratio of a cell's darkest channel to its brightest
_DARK = 0.02  # radiance (1 at clipping) below which a developed cell's hue is that of its codes
_HUBER = 0.03  # threshold of the Huber loss of log ratios
_MODEL = 0.03  # standard error of k by errors of lobe and tone curve
_ROUNDS = 8  # iterations of its weights
_SECTORS, _LEAST_SECTORS, _LEAST_CELLS = 8, 5, 60


def colour_falloff(
    log_ratio: Doubles, cells: CoarseCells, share: Doubles, centre: Doubles, *, developed: bool
) -> tuple[Doubles, Doubles]:
    """(3,) what each channel loses with s more than all do on the mean, and (3,) log factors on it.

    With the log ratio r of photographed and fitted radiance in a channel, less its mean over the
    channels, r = f - k s by robust least squares. k is shrunk by 1 - 4 e^2 / |k|^2, to none
    within twice its standard error e: _MODEL, and by leaving out one sector after the other.

    Args:
        log_ratio: (3, n) photographed over fitted radiance of the cells.
        share: (n,) diffuse share of the fit.
        centre: (2,) of the vignetting, image coordinates.
        developed: not RAW.
    """
    offset = cells.image - centre[:, None]
    squared = np.square(offset).sum(0) / CORNER_SQUARED
    light = np.exp(cells.observed)
    used = (cells.weight > 0.0) & (cells.above == 1.0).all(0) & (share > _MATTE)
    used &= light.min(0) > _GREYEST * light.max(0)
    used &= light.mean(0) > (_DARK if developed else 0.0)
    turns = np.arctan2(offset[1], offset[0]) / (2.0 * np.pi) % 1.0
    sector = np.minimum((_SECTORS * turns).astype(int), _SECTORS - 1)
    present = np.unique(sector[used])
    if used.sum() < _LEAST_CELLS or len(present) < _LEAST_SECTORS:
        return np.zeros(3), np.zeros(3)
    hue = log_ratio - log_ratio.mean(0)

    def lost(some: NDArray[np.bool_]) -> Doubles:
        return _slopes(squared[some], hue[:, some], cells.weight[some])

    whole = lost(used)
    left_out = np.stack([lost(used & (sector != each)) for each in present])
    spread = _MODEL**2 + np.square(left_out - left_out.mean(0)).sum() * (1.0 - 1.0 / len(present))
    kept = whole * max(0.0, 1.0 - 4.0 * spread / max(float(whole @ whole), 1e-12))
    # The cells' mean hue is the fit's.
    return kept, kept * np.average(squared[used], weights=cells.weight[used])


def _slopes(squared: Doubles, hue: Doubles, weight: Doubles) -> Doubles:
    """(3,) k of the robust lines hue (3, n) = f - k s, weighted by (n,)."""
    basis = np.stack([np.ones_like(squared), -squared])
    slopes = np.zeros(3)
    for channel, values in enumerate(hue):
        counts, line = weight, np.zeros(2)
        for _ in range(_ROUNDS):
            line = np.linalg.solve((basis * counts) @ basis.T, (basis * counts) @ values)
            counts = weight * huber(values - line @ basis, _HUBER)[1]
        slopes[channel] = line[1]
    return slopes
