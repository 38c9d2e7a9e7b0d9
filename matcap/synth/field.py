"""Field: random access to the endless material (DESIGN, sections 2 and 7).

The plane is cut into a fixed grid of blocks. A block is always computed whole, on the same grid,
with the same halo of true noise, on one thread: its texels are the same bits whoever asks, in
whatever order, whatever rectangle, and however many blocks are computed side by side.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.model.decoder import ALIGNMENT, DEPTH, OUTPUTS, maps_from_raw
from matcap.model.noise import COORDINATE_LIMIT, SEED_LIMIT, random_field

if TYPE_CHECKING:
    from matcap.model.material import Material

BLOCK = 512  # texels a side; docs/synthesis.md has the measurement
HALO = 80  # texels: beyond the default decoder's reach, so a cut changes nothing (tests/synth)


@dataclass(frozen=True)
class Rectangle:
    """Texels x to x + width, y (downwards) to y + height."""

    x: int
    y: int
    width: int
    height: int


class Field:
    """The endless field of one material and seed.

    Args:
        material: what to read.
        seed: which realisation, in [-2^63, 2^63).
        period: (x, y) repeat in texels, multiples of ALIGNMENT, or None for an endless field.

    Raises:
        UsageError: a seed or period out of range.
    """

    def __init__(
        self, material: Material, seed: int = 0, period: tuple[int, int] | None = None
    ) -> None:
        if not -SEED_LIMIT <= seed < SEED_LIMIT:
            raise UsageError(f"the seed {seed} is out of range", remedy="give one in [-2^63, 2^63)")
        if period is not None and any(p <= 0 or p % ALIGNMENT for p in period):
            raise UsageError(
                f"the period {period[0]}x{period[1]} is not a positive multiple of {ALIGNMENT}",
                remedy=f"round it to a multiple of {ALIGNMENT}",
            )
        self.material = material
        self.seed = seed
        self.period = period
        self._decoder = material.folded()

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
        stacked = torch.empty(OUTPUTS, height, width)
        pieces = list(pieces_of(wanted, self.period))

        def fill(piece: Piece) -> None:
            stacked[(..., *piece.target)] = self.decode_block(piece.block)[(..., *piece.source)]

        with _one_thread_each(), ThreadPoolExecutor(workers or os.cpu_count()) as pool:
            list(pool.map(fill, pieces))
        whole = self.period == (width, height)
        return MapSet.from_stacked(stacked, self.material.texel_size, periodic=whole)

    def decode_block(self, block: Rectangle) -> Tensor:
        """Stacked maps (OUTPUTS, BLOCK, BLOCK) of a block of the grid."""
        size = block.width + 2 * HALO
        with torch.inference_mode():
            field = random_field(
                self.seed,
                self._decoder.noise_channels,
                self.material.waves,
                block.x - HALO,
                block.y - HALO,
                size,
                size,
                levels=DEPTH,
                period=self.period,
            )
            raw = self._decoder(field)[0, :, HALO:-HALO, HALO:-HALO].float().contiguous()
            # Here and not after the cut: a vectorised sigmoid rounds a row's last few texels
            # differently, so it must see the same rows whatever rectangle is asked for.
            return maps_from_raw(raw, self.material.texel_size).stacked()


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Every block is computed on one thread, so that the machine's count changes no bit."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def check_rectangle(wanted: Rectangle) -> Rectangle:
    """The rectangle, or a UsageError when it is empty or beyond the coordinate limit."""
    if wanted.width <= 0 or wanted.height <= 0:
        raise UsageError(
            f"the size {wanted.width}x{wanted.height} is empty",
            remedy="give a width and a height of at least 1",
        )
    ends = (wanted.x, wanted.y, wanted.x + wanted.width, wanted.y + wanted.height)
    if any(abs(end) > COORDINATE_LIMIT for end in ends):
        raise UsageError(
            "the rectangle reaches beyond 2^40 texels", remedy="stay inside [-2^40, 2^40]"
        )
    return wanted


def pieces_of(wanted: Rectangle, period: tuple[int, int] | None) -> Iterator[Piece]:
    """What each block of the grid contributes to a rectangle, row by row.

    A periodic field has blocks in its first cell only: a repeat is the same block read again, and
    so the same bits.
    """
    for rows in _runs(wanted.y, wanted.height, period[1] if period else None):
        for columns in _runs(wanted.x, wanted.width, period[0] if period else None):
            yield Piece(
                block=Rectangle(columns.block, rows.block, BLOCK, BLOCK),
                source=(rows.source, columns.source),
                target=(rows.target, columns.target),
            )


@dataclass(frozen=True)
class Piece:
    """A part of a rectangle that lies in one block; slices are (rows, columns)."""

    block: Rectangle
    source: tuple[slice, slice]
    target: tuple[slice, slice]


@dataclass(frozen=True)
class _Run:
    """The same along one axis."""

    block: int
    source: slice
    target: slice


def _runs(start: int, length: int, period: int | None) -> Iterator[_Run]:
    done = 0
    while done < length:
        place = start + done
        if period is not None:
            place %= period
        block = place // BLOCK * BLOCK
        size = min(block + BLOCK - place, length - done)
        if period is not None:
            size = min(size, period - place)
        yield _Run(block, slice(place - block, place - block + size), slice(done, done + size))
        done += size
