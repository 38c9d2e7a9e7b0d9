"""A field that grows from one material into another across the plane.

The two surfaces lie over each other, and the share of the way says how far the second has risen
through the first: whichever is higher at a texel is seen there. So the border runs along the
relief of both, sharp and without a step in height; two maps that are faded into each other would
lose their contrast where both are half there.

The share is a function of the texel alone: blocks, order and workers change no bit. Where it is 0
or 1 the texels are those of the one material.

Not here: space/between.py, which makes one material between two others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import with_colour
from matcap.brdf.stated import NormalStyle
from matcap.field.blocks import RING, Grid
from matcap.field.material import Material
from matcap.field.plane import Period, Rectangle, Span
from matcap.field.source import Generator, Network, Source, planes_of
from matcap.synth.mask import Mask

_HEIGHT = -1  # among the stacked maps
_RISE = 2.5  # deviations that one surface lies below the other at the ends
_SOFT = 0.2  # deviations within which both are seen
_ENDS = 8.0  # within an eighth of the way from its end a material cannot be hidden altogether
_SAMPLE = Rectangle(0, 0, 256, 256)
_CPU = torch.device("cpu")


@dataclass(frozen=True)
class BlendSource:
    """Between two materials; picklable."""

    first: Source
    second: Source
    """Their fields; one seed, period, grid and texel size."""
    means: tuple[float, float]
    """Of their heights."""
    deviation: float
    """Of their heights, together."""
    mask: Mask
    """The second one's share of every texel."""

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units."""
        return self.first.texel_size

    @property
    def grid(self) -> Grid:
        """The blocks that the plane is cut into."""
        return self.first.grid

    @property
    def period(self) -> Period | None:
        """What repeats."""
        return self.first.period

    @property
    def specular_channels(self) -> int:
        """Of F0: 3 where one of both has a colour."""
        return max(self.first.specular_channels, self.second.specular_channels)

    @property
    def device(self) -> torch.device:
        """Where it is computed."""
        return self.first.device if isinstance(self.first, Network) else _CPU

    @property
    def device_type(self) -> str:
        """Where it is computed."""
        return self.device.type

    def lowered(self, finest: int) -> BlendSource:
        """The same in bfloat16 from level `finest` on to the coarser ones."""
        first, second = (
            source.lowered(finest) if isinstance(source, Network) else source
            for source in (self.first, self.second)
        )
        return replace(self, first=first, second=second)

    def planes(self, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
        """(9 or 11, height, width) of a block: its maps and the normal."""
        return planes_of(self, block, normal)

    def maps(self, block: Rectangle) -> Tensor:
        """Stacked maps (6 or 8, height + 2 RING, width + 2 RING) of a block and its ring."""
        rows, columns = Span(0, block.height).grown(RING), Span(0, block.width).grown(RING)
        with torch.inference_mode():
            share = self.mask.shares(block.x, block.y, rows, columns).to(self.device)
            for source, end in ((self.first, 0.0), (self.second, 1.0)):
                if bool((share == end).all()):
                    return self._of(source, block)
            return self._mix(self._of(self.first, block), self._of(self.second, block), share)

    def _of(self, source: Source, block: Rectangle) -> Tensor:
        """Maps of one of both, its F0 with as many channels as the other's."""
        maps = source.maps(block)
        return maps if self.specular_channels == 1 else with_colour(maps)

    def _mix(self, first: Tensor, second: Tensor, share: Tensor) -> Tensor:
        """Maps of both where they lie at a share (H, W) of the way."""
        below = first[_HEIGHT] - self.means[0]
        # How far the second surface has risen above the first one's mean.
        rise = _RISE * self.deviation * (2.0 * share - 1.0)
        above = second[_HEIGHT] - self.means[1] + rise
        seen = torch.sigmoid((above - below) / (_SOFT * self.deviation))
        # At its ends each material is alone, also where a peak of the other would reach through.
        seen = seen.clamp(1.0 - _ENDS * (1.0 - share), _ENDS * share)
        mixed = torch.lerp(first, second, seen)
        # Where they meet they are as high: no step. What has risen is taken back slowly.
        level = self.means[0] + (self.means[1] - self.means[0]) * share
        mixed[_HEIGHT] = torch.lerp(below, above, seen) + level - rise * share
        return mixed


def blend_source(
    first: Material,
    second: Material,
    mask: Mask,
    seed: int,
    period: Period | None = None,
    device: torch.device = _CPU,
    generator: Generator | None = None,
) -> BlendSource:
    """The field that is `first` where the mask is black and `second` where it is white.

    The texel size is the first one's: the second material is drawn at as many texels as it has.
    By example, if both have an exemplar and nothing else is asked for; otherwise by both decoders.

    Raises:
        UsageError: a seed or period out of range, or generator of which a material has none.
    """
    if generator is None and not all("example" in m.generators for m in (first, second)):
        generator = "decoder"
    start, end = (
        material.by(generator).generator.source(seed, period, device)
        for material in (first, second)
    )
    end = _changed(end, texel_size=start.texel_size, grid=start.grid)
    heights = [
        _changed(source, seed=0, period=None).maps(_SAMPLE)[_HEIGHT] for source in (start, end)
    ]
    means = (float(heights[0].mean()), float(heights[1].mean()))
    deviation = max(sum(float(height.std()) for height in heights), 1e-9 * start.texel_size)
    return BlendSource(start, end, means, deviation, mask)


def _changed(source: Source, **fields: Any) -> Source:  # noqa: ANN401
    """A source with other fields: all of them are frozen dataclasses."""
    changed: Source = replace(cast(Any, source), **fields)
    return changed
