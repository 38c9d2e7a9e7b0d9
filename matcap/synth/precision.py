"""Choice of precision: float32, bfloat16, or bfloat16 where the error is invisible.

bfloat16 takes half the time on devices that support it, and keeps eight significant bits of every
feature. The error it causes depends on the material. It is measured on two blocks, in 8-bit steps
of the encoded maps (diffuse as sRGB, height over its range).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from matcap.errors import MatcapError
from matcap.field.device import multiplies_bfloat16
from matcap.field.plane import Rectangle
from matcap.field.single import single_threaded
from matcap.field.source import Network, Source
from matcap.files.srgb import srgb_picture
from matcap.synth.pictures import kind_planes

Precision = Literal["fp32", "bf16", "auto"]
HALF_STEP = 0.5
# (column, row) of the sample blocks.
_SAMPLES = ((0, 0), (1001, -77))
# By how many of the finest levels stay in float32, the fastest first.
_CHOICES = {0: "bf16", 1: "bf16 below full resolution", 2: "bf16 below half resolution"}


@dataclass(frozen=True)
class ChosenPrecision:
    """A source in the chosen precision."""

    source: Source
    name: str
    """"fp32", "bf16" or one of _CHOICES."""
    steps: dict[str, float]
    """Largest difference from fp32 in 8-bit steps by map; empty if not measured."""

    def sentence(self) -> str:
        """The precision and its largest error, as a phrase."""
        if not self.steps:
            return f"precision {self.name}"
        worst = max(self.steps, key=lambda kind: self.steps[kind])
        return f"precision {self.name}: at most {self.steps[worst]:.2f} 8-bit steps off ({worst})"


def choose(source: Network, precision: Precision) -> ChosenPrecision:
    """Choose the precision of a source.

    Args:
        source: in float32.
        precision: "auto" is the fastest whose largest error is below half an 8-bit step in every
            map of the sample blocks; on devices without bfloat16 that is float32.

    Raises:
        MatcapError: "bf16", and the device does not support it.
    """
    if precision == "fp32":
        return ChosenPrecision(source, "fp32", {})
    if not multiplies_bfloat16(source.device):
        if precision == "auto":
            return ChosenPrecision(source, "fp32", {})
        raise MatcapError.at("--precision", "this device does not multiply bfloat16", "use fp32")
    if precision == "bf16":
        return ChosenPrecision(source.lowered(0), "bf16", {})
    exact, kinds = list(_samples(source)), kind_planes(source.specular_channels)
    for finest, name in _CHOICES.items():
        cheaper = source.lowered(finest)
        steps = _largest(exact, _samples(cheaper), kinds)
        if max(steps.values()) < HALF_STEP:
            return ChosenPrecision(cheaper, name, steps)
    return ChosenPrecision(source, "fp32", {})


def _samples(source: Network) -> Iterator[Tensor]:
    """The stored planes of the sample blocks."""
    grid = source.grid
    with single_threaded(1) as pool:
        for column, row in _SAMPLES:
            block = Rectangle(column * grid.width, row * grid.height, grid.width, grid.height)
            yield torch.from_numpy(pool.submit(source.planes, block, "gl").result())


def _largest(
    exact: list[Tensor], rough: Iterator[Tensor], kinds: Mapping[str, tuple[int, ...]]
) -> dict[str, float]:
    """Largest absolute difference over all samples, in 8-bit steps, by map."""
    heights = torch.cat([planes[list(kinds["height"])].flatten() for planes in exact])
    span = max(float(heights.max() - heights.min()), 1e-12)
    steps = dict.fromkeys(kinds, 0.0)
    for one, other in zip(exact, rough, strict=True):
        for kind, places in kinds.items():
            a, b = (_coded(kind, planes[list(places)], span) for planes in (one, other))
            steps[kind] = max(steps[kind], 255.0 * float((a - b).abs().max()))
    return steps


def _coded(kind: str, values: Tensor, span: float) -> Tensor:
    """Values scaled so that a difference of 1/255 is one step of an 8-bit image."""
    if kind == "diffuse":
        return torch.from_numpy(srgb_picture(values.numpy()))
    if kind == "height":
        return values / span
    return 0.5 * values if kind == "normal" else values
