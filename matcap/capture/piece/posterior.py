"""MAP estimate of the slope energy of each band, from the network's prediction and a measurement.

With p_b the network's energy of band b, m_b and d_b the measured one and its standard deviation,

    minimise  sum_b ((p_b e^{x_b} - m_b) / d_b)^2 + sum_b ((x_b - c) / s)^2 + (c / t)^2

over the log factors x_b of each band and c common to all (s, t: STRENGTH.each_band and .together).
A network shrinks uncertain relief, all bands alike and each a little on its own. Well-measured
bands take the measurement; bands measured as zero shrink by the inverse of its variance; bands
without a measurement follow the others.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.capture.piece.tuned import STRENGTH

Doubles = NDArray[np.float64]


def posterior_energies(drawn: Doubles, measured: Doubles, doubt: Doubles) -> Doubles:
    """(bands,) squared slopes of the MAP estimate, by exhaustive search on a grid.

    Args:
        drawn: (bands,) squared slopes of the network's relief, positive.
        measured: (bands,) by the photograph, not negative.
        doubt: (bands,) standard deviations of `measured`.
    """
    reach, step = STRENGTH.posterior_reach, STRENGTH.posterior_step
    logs = np.arange(-reach, reach + step / 2.0, step)
    scatter = doubt[:, None] + STRENGTH.least_energy
    off = np.square((drawn[:, None] * np.exp(logs) - measured[:, None]) / scatter)
    # (common, band, own): c, b and x_b of the module's docstring.
    own_cost = np.square((logs - logs[:, None]) / STRENGTH.each_band)[:, None, :]
    price = own_cost + off
    best = price.argmin(-1)
    total = price.min(-1).sum(1) + np.square(logs / STRENGTH.together)
    return np.asarray(drawn * np.exp(logs[best[total.argmin()]]))
