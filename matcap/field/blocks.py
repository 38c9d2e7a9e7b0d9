"""The fixed grid of blocks of the plane, and the blocks that a rectangle needs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from matcap.errors import UsageError
from matcap.field.plane import COORDINATE_LIMIT, Period, Rectangle

BLOCK = 512  # texels along x; docs/notes/field.md has the measurement
BLOCK_HEIGHT = 256
RING = 1  # texels around a block that its normals look at


@dataclass(frozen=True)
class Grid:
    """Blocks of so many texels, both multiples of ALIGNMENT, one of them beginning at (0, 0)."""

    width: int = BLOCK
    height: int = BLOCK_HEIGHT


@dataclass(frozen=True)
class Piece:
    """A part of a rectangle that lies in one block; slices are (rows, columns)."""

    block: Rectangle
    source: tuple[slice, slice]
    target: tuple[slice, slice]

    @property
    def texels(self) -> int:
        """How many."""
        rows, columns = self.target
        return (rows.stop - rows.start) * (columns.stop - columns.start)


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


def pieces_of(wanted: Rectangle, grid: Grid, period: Period | None) -> Iterator[Piece]:
    """What each block of the grid contributes to a rectangle, row by row.

    A periodic field has blocks in its first cell only: a repeat is the same block read again, and
    so the same bits.
    """
    along_x, along_y = period or (None, None)
    for rows in _runs(wanted.y, wanted.height, grid.height, along_y):
        for columns in _runs(wanted.x, wanted.width, grid.width, along_x):
            yield Piece(
                block=Rectangle(columns.block, rows.block, grid.width, grid.height),
                source=(rows.source, columns.source),
                target=(rows.target, columns.target),
            )


@dataclass(frozen=True)
class _Run:
    """A piece along one axis."""

    block: int
    source: slice
    target: slice


def _runs(start: int, length: int, side: int, period: int | None) -> Iterator[_Run]:
    done = 0
    while done < length:
        place = start + done
        if period is not None:
            place %= period
        block = place // side * side
        size = min(block + side - place, length - done)
        if period is not None:
            size = min(size, period - place)
        yield _Run(block, slice(place - block, place - block + size), slice(done, done + size))
        done += size
