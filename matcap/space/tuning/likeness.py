"""Texture distance of a material to a photograph: windows rendered under its light.

The loss of a decoder [henzler2021, sec. 4.3 and 4.6].
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.field.device import computes_bfloat16
from matcap.flash.geometry import FlashSetup
from matcap.flash.render import render_flash
from matcap.space.drawing import Drawing
from matcap.space.tuning.windows import Windows, shot_deviation
from matcap.statistics.compare import Features, Weights, describe, distance
from matcap.statistics.encoding import Encoding
from matcap.statistics.lattice import Wave


@dataclass(frozen=True)
class PhotographTarget:
    """Target statistics of windows of a photograph."""

    windows: Windows
    """Windows, with their statistics."""
    setup: FlashSetup
    """Camera and flash."""
    encoding: Encoding
    """Colour space of the comparison."""
    bank: Features
    """Features whose statistics are compared."""
    waves: tuple[Wave, ...]
    """Frequency vectors of the photograph's lattice, cycles per texel."""
    texel_size: float
    """Side of a texel, plane units."""
    weights: Weights = Weights()
    """Weights of the statistics."""
    expected: Tensor | None = None
    """(5,) logits of the coarse fit's diffuse albedo, F0 and roughness, or None."""
    drawing: Drawing | None = None
    """The drawing that the decoder reads, or None."""


def shuffled(count: int, seed: int) -> Iterator[int]:
    """Yield random permutations of 0 ... count - 1, without end."""
    generator = torch.Generator().manual_seed(seed)
    while True:
        yield from torch.randperm(count, generator=generator).tolist()


def render_windows(maps: MapSet, target: PhotographTarget, places: Tensor, step: int) -> Tensor:
    """(B, 3, size, size) radiance of maps, lit and viewed as at `places`, with sensor noise."""
    windows = target.windows
    rendered = render_flash(maps, target.setup, windows.points[places])
    return rendered if windows.noise is None else with_noise(rendered, windows.noise[places], step)


def compare_windows(
    rendered: Tensor, target: PhotographTarget, places: Tensor, *, half_precision: bool
) -> Tensor:
    """Mean texture distance of renderings to the photograph's windows at `places`; a scalar."""
    with torch.autocast("cpu", torch.bfloat16, enabled=half_precision and computes_bfloat16()):
        described = describe(rendered, target.encoding, target.bank)
    return distance(described, target.windows.target.select(places), target.weights).mean()


def with_noise(rendered: Tensor, noise: Tensor, step: int) -> Tensor:
    """Add sensor noise (Windows.noise) to renderings (B, 3, size, size).

    The noise is shifted and signed at random by step, and scaled by shot_deviation.
    """
    generator = torch.Generator().manual_seed(step)
    down, across, sign = torch.randint(noise.shape[-1], (3,), generator=generator).tolist()
    moved = noise.roll((down, across), dims=(-2, -1)) * (1.0 if sign % 2 else -1.0)
    return rendered + moved * shot_deviation(rendered.detach())
