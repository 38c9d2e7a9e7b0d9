"""How strong relief is believed to be: what a network drew, held to what the photograph tells.

The most probable energies of all bands. A network shrinks what it is not sure of, all bands alike
and each a little on its own; the photograph tells each band's energy with a doubt. So what is told
well is taken as told, however much stronger it is than what was drawn; what is told to be nothing
goes down as far as the telling is certain; and what nothing is told of follows the other bands.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from matcap.capture.piece.tuned import STRENGTH

Doubles = NDArray[np.float64]


def believed(drawn: Doubles, told: Doubles, doubt: Doubles) -> Doubles:
    """(bands,) squared slopes.

    Args:
        drawn: (bands,) squared slopes of the network's relief, positive.
        told: (bands,) as the photograph tells them, not negative.
        doubt: (bands,) standard deviations of what is told.
    """
    reach, step = STRENGTH.believed_reach, STRENGTH.believed_fineness
    logs = np.arange(-reach, reach + step / 2.0, step)
    scatter = doubt[:, None] + STRENGTH.least_energy
    off = np.square((drawn[:, None] * np.exp(logs) - told[:, None]) / scatter)
    # (common, band, own): what the drawing is off by on the whole, and a band in all.
    apart = np.square((logs - logs[:, None]) / STRENGTH.each_band)[:, None, :]
    price = apart + off
    best = price.argmin(-1)
    total = price.min(-1).sum(1) + np.square(logs / STRENGTH.together)
    return np.asarray(drawn * np.exp(logs[best[total.argmin()]]))
