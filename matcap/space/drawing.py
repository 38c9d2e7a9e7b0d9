"""The drawing that a decoder reads besides noise: log luminance and relief of an endless field.

The default generator rearranges the exemplar for every seed; the decoder turns this field's drawing
into maps. Channels are standardised by the exemplar:

    log(Y),    h - mean of h over a square of 2 AROUND + 1 texels,

with Y the luminance of diffuse albedo (where F0 has a colour, of their sum) and h the height in
texels. Level k has means of 2^k x 2^k texels. Statistics alone close no cell of leather, however
well they are matched (docs/notes/prior.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.example.example import Example
from matcap.example.exemplar import COLOURED, DIFFUSE, HEIGHT, SPECULAR
from matcap.field.plane import Period, Rectangle
from matcap.files.rec709 import LUMINANCE
from matcap.space.decoder import DEPTH

AROUND = 16  # texels; slower relief is no pattern
_DARKEST = 1e-3  # least luminance
_FLAT = 1e-4  # least deviation that is standardised


@dataclass(frozen=True)
class Drawing:
    """The drawing of an example's field, at every seed; picklable."""

    example: Example

    @property
    def alignment(self) -> int:
        """Texels: periods of its field are multiples of this."""
        return self.example.alignment

    def levels(
        self, seed: int, area: Rectangle, period: Period | None = None
    ) -> tuple[Tensor, ...]:
        """(1, DRAWING_CHANNELS, height / 2^k, width / 2^k) of each level k on the way up.

        Args:
            seed: of the realisation.
            area: whose corner and sides are multiples of 2^(DEPTH - 1) texels.
            period: of the field, or None.
        """
        return self.levels_of(self.around(seed, area, period))

    def around(self, seed: int, area: Rectangle, period: Period | None = None) -> Tensor:
        """Stacked maps of the field over an area and what levels_of() needs around it."""
        return torch.from_numpy(self.example.maps(seed, area.grown(AROUND), period))

    def levels_of(self, maps: Tensor) -> tuple[Tensor, ...]:
        """The drawing of stacked maps (6 or 8, H + 2 AROUND, W + 2 AROUND); see levels()."""
        mean, deviation = self._moments
        levels = [((self._planes(maps) - mean) / deviation)[None]]
        for _ in range(DEPTH - 1):
            levels.append(F.avg_pool2d(levels[-1], 2))
        return tuple(levels)

    @cached_property
    def _moments(self) -> tuple[Tensor, Tensor]:
        """(DRAWING_CHANNELS, 1, 1) mean and deviation over the exemplar."""
        maps = torch.from_numpy(self.example.exemplar.stacked())[None]
        planes = self._planes(F.pad(maps, (AROUND,) * 4, mode="replicate")[0])
        mean, deviation = planes.mean((1, 2), keepdim=True), planes.std((1, 2), keepdim=True)
        return mean, deviation.clamp_min(_FLAT)

    def _planes(self, maps: Tensor) -> Tensor:
        """The drawing before it is standardised, (DRAWING_CHANNELS, H, W)."""
        colour = maps[DIFFUSE]
        if len(maps[SPECULAR]) == COLOURED:
            colour = colour + maps[SPECULAR]
        luminance = torch.tensordot(colour.new_tensor(LUMINANCE), colour, 1)
        height, side = maps[HEIGHT] / self.example.exemplar.texel_size, 2 * AROUND + 1
        mean = F.avg_pool2d(F.avg_pool2d(height, (side, 1), 1), (1, side), 1)
        within = (..., slice(AROUND, -AROUND), slice(AROUND, -AROUND))
        drawn = luminance.clamp_min(_DARKEST).log()[None]
        return torch.cat([drawn[within], height[within] - mean])
