"""Field: random access to the endless material."""

from __future__ import annotations

import os

import torch

from matcap.brdf.maps import MapSet
from matcap.field.device import DeviceName, find_device
from matcap.field.plane import BLOCK, BlockPart, Period, Rectangle, block_parts, check_rectangle
from matcap.field.source import MAP_CHANNELS, Generated, Generator, Source, inner, single_threaded

# The plane is cut into a fixed grid of blocks. A block is always computed whole, from the same
# inputs, on one thread. Its texels therefore have the same bits whatever rectangle is read, in
# whatever order, and however many blocks are computed in parallel.
#
# Read next: source.py (one block), synth/stream.py (rectangles of any size, to files).


__all__ = ["BLOCK", "Field", "Rectangle"]


class Field:
    """The endless field of one material and seed.

    Args:
        material: the material to synthesise.
        seed: of the realisation, in [-2^63, 2^63).
        period: repeat in texels along (x, y), multiples of the material's alignment; None, for
            both axes or for one, is endless.
        device: "cpu", "cuda", or "auto" for CUDA where available. Devices differ in the last bits.
            Maps are returned on the processor. The example generator always uses the processor.
        generator: "example" or "decoder"; None is "example" where there is an exemplar.

    Raises:
        UsageError: a seed or period out of range, no CUDA device, or a generator that the material
            does not have.
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
        """Compute the maps of a rectangle.

        Normals of the result are finite differences of the height inside the rectangle. A rectangle
        of exactly one period is marked periodic.

        Args:
            x, y: upper left texel; y grows downwards.
            width, height: in texels.
            workers: blocks computed in parallel, by default one a core; changes no bit.

        Raises:
            UsageError: an empty rectangle, or coordinates beyond 2^40.
        """
        wanted = check_rectangle(Rectangle(x, y, width, height))
        return read_source(self.source, wanted, workers or os.cpu_count() or 1)


def read_source(source: Source, wanted: Rectangle, workers: int) -> MapSet:
    """Compute the maps of a rectangle with `workers` threads; see Field.read."""
    channels = MAP_CHANNELS + source.specular_channels
    stacked = torch.empty(channels, wanted.height, wanted.width)
    parts: dict[Rectangle, list[BlockPart]] = {}  # a block that repeats is computed once
    for part in block_parts(wanted, source.grid, source.period):
        parts.setdefault(part.block, []).append(part)

    def fill(block: Rectangle) -> None:
        # Threads do not inherit the caller's inference mode.
        with torch.inference_mode():
            planes = inner(source.maps(block)).cpu()
            for part in parts[block]:
                stacked[(..., *part.target)] = planes[(..., *part.source)]

    with single_threaded(min(workers, len(parts))) as pool:
        list(pool.map(fill, parts))
    whole = source.period == (wanted.width, wanted.height)
    return MapSet.from_stacked(stacked, source.texel_size, periodic=whole)
