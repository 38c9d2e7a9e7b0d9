"""Height-based blending of two materials by a mask.

The second surface is raised through the first as the mask's share s goes from 0 to 1; each texel
shows the higher of the two. The border follows the relief of both, is sharp, and has no step in
height. Linear interpolation of the maps would lose contrast where s is about 1/2.

With heights h1, h2 less their means m1, m2, and the sum d of their standard deviations:

    r = 2.5 d (2 s - 1)                               offset of the second surface
    w = sigmoid((h2 + r - h1) / (0.2 d))              weight of the second material
    maps = lerp(maps1, maps2, w)
    height = lerp(h1, h2 + r, w) - r s + lerp(m1, m2, s)

w is limited so that it is exactly 0 at s = 0 and 1 at s = 1. s depends on the texel alone, so that
blocks and workers change no bit.

space/between.py is something else: it interpolates two materials to a single one.
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
from matcap.field.blocks import RING
from matcap.field.material import Material
from matcap.field.plane import Period, Rectangle, Span
from matcap.field.source import DerivedSource, Generator, Network, Source, planes_of
from matcap.synth.mask import Mask

_HEIGHT = -1  # channel of the stacked maps
_RISE = 2.5  # offset of the second surface at s = 1, in units of d
_SOFT = 0.2  # width of the transition, in units of d
_ENDS = 8.0  # w is limited to [1 - 8 (1 - s), 8 s]
_SAMPLE = Rectangle(0, 0, 256, 256)
_CPU = torch.device("cpu")


@dataclass(frozen=True)
class BlendSource(DerivedSource):
    """The blended field of two materials; picklable."""

    second: Source
    """A field of the same seed, period, grid and texel size as `source`."""
    means: tuple[float, float]
    """Mean heights of both, in plane units."""
    deviation: float
    """Sum of the standard deviations of their heights, in plane units."""
    mask: Mask
    """Share of the second material by texel."""

    @property
    def specular_channels(self) -> int:
        """Channels of F0: 3 if that of either material has a colour, else 1."""
        return max(self.source.specular_channels, self.second.specular_channels)

    @property
    def device(self) -> torch.device:
        """Device that computes it."""
        return self.source.device if isinstance(self.source, Network) else _CPU

    def lowered(self, finest: int) -> BlendSource:
        """A copy whose networks compute level `finest` and all coarser levels in bfloat16."""
        first, second = (
            source.lowered(finest) if isinstance(source, Network) else source
            for source in (self.source, self.second)
        )
        return replace(self, source=first, second=second)

    def planes(self, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
        """(9 or 11, height, width) maps and normal of a block."""
        return planes_of(self, block, normal)

    def maps(self, block: Rectangle) -> Tensor:
        """Stacked maps (6 or 8, height + 2 RING, width + 2 RING) of a block and its ring."""
        rows, columns = Span(0, block.height).grown(RING), Span(0, block.width).grown(RING)
        with torch.inference_mode():
            share = self.mask.shares(block.x, block.y, rows, columns).to(self.device)
            for source, end in ((self.source, 0.0), (self.second, 1.0)):
                if bool((share == end).all()):
                    return self._of(source, block)
            return self._mix(self._of(self.source, block), self._of(self.second, block), share)

    def _of(self, source: Source, block: Rectangle) -> Tensor:
        """Maps of one material, F0 expanded to as many channels as the blend has."""
        maps = source.maps(block)
        return maps if self.specular_channels == 1 else with_colour(maps)

    def _mix(self, first: Tensor, second: Tensor, share: Tensor) -> Tensor:
        """Blend stacked maps of both by shares (H, W); see the module's equations."""
        below = first[_HEIGHT] - self.means[0]
        rise = _RISE * self.deviation * (2.0 * share - 1.0)
        above = second[_HEIGHT] - self.means[1] + rise
        seen = torch.sigmoid((above - below) / (_SOFT * self.deviation))
        # Otherwise a high peak of the hidden material would show at s = 0 or 1.
        seen = seen.clamp(1.0 - _ENDS * (1.0 - share), _ENDS * share)
        mixed = torch.lerp(first, second, seen)
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
    """The field of `first` where the mask is black, and of `second` where it is white.

    The result has the first material's texel size; the second is not resampled to it.

    Args:
        seed: of both fields, in [-2^63, 2^63).
        period: in texels, or None.
        generator: of both; None is "example" if both have an exemplar, else "decoder".

    Raises:
        UsageError: a seed or period out of range, or a generator that a material does not have.
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
    """dataclasses.replace on a source: every source is a frozen dataclass."""
    return replace(cast(Any, source), **fields)
