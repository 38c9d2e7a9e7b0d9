"""The tone curve of a developed picture, which comes before the colour space's own curve.

    g(x) = x^c / (1 - w + w x^c),    g(0) = 0,  g(1) = 1,

with x light over the clip level: contrast by the exponent c, a shoulder by w. It is one curve for
all channels. c is fitted with the photograph's light (flash/coarse); w hardly shows in one and
is held at a phone's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.files.values import bounded

SHOULDER = 0.27  # w of a developed picture; fitted as well, it hardly moves (docs/notes/gloss.md)


@dataclass(frozen=True)
class Development:
    """Prior of a developed picture's tone curve, by default that of a phone's JPEG."""

    log_exponent: float = 0.12
    """Mean of log c."""
    deviation: float = 0.08
    """Standard deviation of log c."""
    shoulder: float = SHOULDER
    """w, held."""


# Base and HDR gain map together: the shoulder is undone, and dark tones are as in the base, which
# has nearly no gain there.
WITH_GAIN_MAP = Development(0.04, 0.05, 0.0)


@dataclass(frozen=True)
class ToneCurve:
    """g with its two numbers; by default the identity."""

    exponent: float = 1.0
    """Exponent c, above 0."""
    shoulder: float = 0.0
    """Weight w of the shoulder, in [0, 1)."""

    @staticmethod
    def of_report(report: dict[str, Any]) -> ToneCurve:
        """Tone curve of a capture's photograph by report.json; the identity without one."""
        try:
            stated = report["camera"]["tone_curve"]
            return ToneCurve(
                bounded(stated["exponent"], "exponent", 0.1, 10.0),
                bounded(stated["shoulder"], "shoulder", 0.0, 0.99),
            )
        except (KeyError, TypeError, ValueError):
            return ToneCurve()

    def developed(self, light: NDArray[Any]) -> NDArray[Any]:
        """Light at least 0 through the curve, any shape; beyond the clip level it stays beyond."""
        if self == ToneCurve():
            return light
        power = np.power(light, self.exponent)
        return np.asarray(power / (1.0 + self.shoulder * (power - 1.0)), light.dtype)

    def linear(self, picture: NDArray[Any]) -> NDArray[Any]:
        """The inverse of developed() up to white; beyond it, below a shoulder, ratios are kept."""
        if self == ToneCurve():
            return picture
        if self.shoulder == 0.0:
            return np.asarray(np.power(picture, 1.0 / self.exponent), picture.dtype)
        within = np.minimum(picture, 1.0)
        power = within * (1.0 - self.shoulder) / (1.0 - self.shoulder * within)
        light = np.power(power, 1.0 / self.exponent) * np.maximum(picture, 1.0)
        return np.asarray(light, picture.dtype)
