"""Field: random access to the endless material.

The plane is cut into a fixed grid of blocks. A block is always computed whole, on the same grid,
from the same true noise around it, on one thread: its texels are the same bits for every caller, in
whatever order, whatever rectangle, and however many blocks are computed side by side.

Read next: source.py (one block), synth/stream.py (rectangles of any size, to files).
"""

from __future__ import annotations

import os

import torch

from matcap.brdf.maps import MapSet
from matcap.field.blocks import BLOCK, Piece, check_rectangle, pieces_of
from matcap.field.device import DeviceName, find_device
from matcap.field.plane import Period, Rectangle
from matcap.field.single import single_threaded
from matcap.field.source import MAP_CHANNELS, Generated, Generator, Source, inner

__all__ = ["BLOCK", "Field", "Rectangle"]


class Field:
    """The endless field of one material and seed.

    Args:
        material: what to read.
        seed: which realisation, in [-2^63, 2^63).
        period: repeat in texels along (x, y), multiples of the material's
            alignment; None, for both or for one of them, is endless.
        device: where to compute: "cpu", "cuda", or "auto" for CUDA where it is there. The maps
            come back to the processor. Devices differ in the last bits. By example always on
            the processor.
        generator: "example" or "decoder"; by default by example where there is an exemplar.

    Raises:
        UsageError: a seed or period out of range, or no CUDA device or exemplar where one was
            asked for.
    """

    def __init__(
        self,
        material: Generated,
        seed: int = 0,
        period: Period | None = None,
        *,
        device: DeviceName = "cpu",
        generator: Generator | None = None,
    ) -> None:
        place = find_device(device)
        self.source: Source = material.by(generator).generator.source(seed, period, place)

    def read(
        self, x: int, y: int, width: int, height: int, *, workers: int | None = None
    ) -> MapSet:
        """Maps of a rectangle; texel (x, y) is left top, y grows downwards.

        `workers` blocks are computed side by side (default: one a core); their number changes no
        bit. The height is finite-differenced inside the rectangle; a rectangle that is the whole
        period is marked periodic.

        Raises:
            UsageError: an empty rectangle, or one beyond 2^40.
        """
        wanted = check_rectangle(Rectangle(x, y, width, height))
        return read_source(self.source, wanted, workers or os.cpu_count() or 1)


def read_source(source: Source, wanted: Rectangle, workers: int) -> MapSet:
    """Maps of a rectangle of any source, with so many threads."""
    channels = MAP_CHANNELS + source.specular_channels
    stacked = torch.empty(channels, wanted.height, wanted.width)
    pieces = list(pieces_of(wanted, source.grid, source.period))

    def fill(piece: Piece) -> None:
        # Whether the caller's tensors are for inference only or not, they are so here.
        with torch.inference_mode():
            planes = inner(source.maps(piece.block))[(..., *piece.source)]
            stacked[(..., *piece.target)] = planes.cpu()

    with single_threaded(min(workers, len(pieces))) as pool:
        list(pool.map(fill, pieces))
    whole = source.period == (wanted.width, wanted.height)
    return MapSet.from_stacked(stacked, source.texel_size, periodic=whole)
