"""Receptive fields: the span of every decoder level that a block of output needs.

Computed from the output back to the noise, so that convolutions need no padding. Spans are along
one axis, in texels of their level, counted from the block's first texel.
"""

from __future__ import annotations

from dataclasses import dataclass

from matcap.field.plane import Span
from matcap.space.decoder import DEPTH


@dataclass(frozen=True)
class Spans:
    """Spans of every level along one axis, full resolution first."""

    output: Span
    """Span of the raw outputs."""
    joined: tuple[Span, ...]
    """Span of the input of each upward block (the level below upsampled, skip connection, lattice),
    for levels 0 to DEPTH - 1. The outermost upsampled texel is not valid."""
    risen: tuple[Span, ...]
    """Span of each level that is upsampled, for levels 1 to DEPTH; entry 0 is the output."""
    down: tuple[Span, ...]
    """Span of the input of each downward block; entry 0 is the noise."""
    skips: tuple[Span, ...]
    """Span of the output of each downward block, which the skip connection takes."""


def spans_of(output: Span, convolutions: tuple[int, int]) -> Spans:
    """Spans for an output; `convolutions` are 3 x 3 ones per block on the way down and up."""
    down_count, up_count = convolutions
    risen, joined = [output], []
    for _ in range(DEPTH):
        valid = risen[-1].grown(up_count)
        # Upsampled texel i is interpolated from texels (i - 1) // 2 and (i + 1) // 2.
        risen.append(Span((valid.start - 1) // 2, valid.stop // 2 + 1))
        joined.append(risen[-1].doubled())
    skips = [risen[-1]]
    down = [skips[-1].grown(down_count)]
    for _ in range(DEPTH):
        skips.append(down[-1].doubled())
        down.append(skips[-1].grown(down_count))
    return Spans(output, tuple(joined), tuple(risen), tuple(down[::-1]), tuple(skips[::-1]))
