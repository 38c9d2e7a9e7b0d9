"""What a highlight says of the coarse fit: seven measurements besides the cells.

The mirror point (2) converges from any distance, but is only near the centre of a wide highlight;
the symmetry of the half-width ring (2) is exact; radiance of peak, ring and surroundings (3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property

import torch
from torch import Tensor

from matcap.flash.coarse.model import numbers
from matcap.flash.highlight import SURROUNDINGS, Highlight

# Weight of the seven measurements; in a RAW they only help convergence, a tone curve changes the
# surroundings. Where one of several minima is chosen it is greater: laminate, whose sharp highlight
# covers few cells, would else be satin under a narrow flash.
WEIGHT, WEIGHT_BETWEEN = 0.005, 0.05
# Standard deviation of the highlight's centre from the mirror point: plane units, plus a share of
# its half width; the same of the centre of its half-way ring.
_CENTRE_DEVIATION, _MIDDLE_DEVIATION = (0.006, 0.1), (0.004, 0.03)
_LEVEL_DEVIATION = 0.1  # of peak, half-way level and surroundings, log radiance
_DIRECTIONS = 12  # points of a ring


@dataclass(frozen=True)
class Evidence:
    """A highlight's measurements, and their weight as a share of the picture's."""

    highlight: Highlight
    weight: float = WEIGHT

    @cached_property
    def image(self) -> Tensor:
        """(2, 3 * directions) image coordinates: the centre, the half-width ring, outside."""
        radii = (0.0, self.highlight.width, 0.5 * sum(SURROUNDINGS))
        centre = numbers(*self.highlight.centre)[:, None]
        return torch.cat([centre + radius * _circle() for radius in radii], dim=1)

    @property
    def weights(self) -> Tensor:
        """(7,) weight of each residual."""
        return torch.full((7,), self.weight, dtype=torch.float64)

    def residuals(self, mirror: Tensor, log_radiance: Tensor) -> Tensor:
        """(7,) standardised residuals of a model.

        Args:
            mirror: (2,) image coordinates of its mirror point.
            log_radiance: (3, 3 * directions) at `image`.
        """
        highlight = self.highlight
        off = (mirror - numbers(*highlight.centre)) / _deviation(_CENTRE_DEVIATION, highlight)
        radiance = log_radiance.exp()
        light = radiance.clamp_max(max(1.0, highlight.peak)).mean(0).log()  # as the camera clips
        rings = light.unflatten(0, (3, _DIRECTIONS))
        slope = math.log(highlight.contrast) / (2.0 * highlight.width)
        middle = 2.0 * (rings[1] * _circle()).mean(1) / slope
        half_way = 0.5 * (highlight.peak + highlight.surroundings)
        expected = torch.tensor([highlight.peak, half_way, highlight.surroundings]).double().log()
        levels = (rings.mean(1) - expected) / _LEVEL_DEVIATION
        return torch.cat([off, middle / _deviation(_MIDDLE_DEVIATION, highlight), levels])


def _deviation(parts: tuple[float, float], highlight: Highlight) -> float:
    """Standard deviation of a position: plane units, plus a share of the half width."""
    return parts[0] + parts[1] * highlight.width


@cache
def _circle() -> Tensor:
    """(2, directions) unit vectors at equal angles."""
    turn = torch.arange(_DIRECTIONS, dtype=torch.float64) * (2.0 * math.pi / _DIRECTIONS)
    return torch.stack([turn.cos(), turn.sin()])
