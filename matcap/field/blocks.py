"""The fixed grid of blocks that the plane is cut into, and the blocks that a rectangle covers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from matcap.errors import UsageError
from matcap.field.plane import COORDINATE_LIMIT, Period, Rectangle

BLOCK = 512  # texels along x; docs/notes/field.md has the measurement
BLOCK_HEIGHT = 256
RING = 1  # texels around a block from which its border's slopes are computed


@dataclass(frozen=True)
class Grid:
    """Blocks of width x height texels; one has its upper left texel at (0, 0)."""

    width: int = BLOCK
    height: int = BLOCK_HEIGHT


@dataclass(frozen=True)
class BlockPart:
    """The part of a requested rectangle that lies in one block."""

    block: Rectangle
    source: tuple[slice, slice]
    """Rows and columns of the block."""
    target: tuple[slice, slice]
    """Rows and columns of the rectangle."""

    @property
    def texels(self) -> int:
        """Number of texels."""
        rows, columns = self.target
        return (rows.stop - rows.start) * (columns.stop - columns.start)


def check_rectangle(wanted: Rectangle) -> Rectangle:
    """Return the rectangle.

    Raises:
        UsageError: it is empty, or reaches beyond COORDINATE_LIMIT.
    """
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


def block_parts(wanted: Rectangle, grid: Grid, period: Period | None) -> Iterator[BlockPart]:
    """Cut a rectangle into its parts by block, row by row.

    Coordinates of a periodic field are taken modulo the period, so that every repeat reads the
    same blocks and gets the same bits.
    """
    along_x, along_y = period or (None, None)
    for rows in _runs(wanted.y, wanted.height, grid.height, along_y):
        for columns in _runs(wanted.x, wanted.width, grid.width, along_x):
            yield BlockPart(
                block=Rectangle(columns.block, rows.block, grid.width, grid.height),
                source=(rows.source, columns.source),
                target=(rows.target, columns.target),
            )


@dataclass(frozen=True)
class _Run:
    """A part along one axis: the block's first texel, and slices of block and rectangle."""

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
