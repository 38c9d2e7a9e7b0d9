"""The endless plane: coordinates and limits, exact phases of waves, the grid of blocks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from matcap.errors import UsageError
from matcap.files.settings import COORDINATE_LIMIT as COORDINATE_LIMIT
from matcap.files.settings import SEED_LIMIT
from matcap.files.settings import Rectangle as Rectangle

# Coordinates on the endless plane: periods, seeds and spans, with their limits.
#
# Imports no PyTorch, for a fast start.

# Period of a field in texels along x and y; None for an axis along which it never repeats.
Period = tuple[int | None, int | None]


def check_seed(seed: int) -> int:
    """Return the seed; raise UsageError outside [-2^63, 2^63)."""
    if not -SEED_LIMIT <= seed < SEED_LIMIT:
        raise UsageError(f"the seed {seed} is out of range", remedy="give one in [-2^63, 2^63)")
    return seed


def check_variety(variety: float) -> float:
    """Return the variety; raise UsageError outside [0, 1]."""
    if not 0.0 <= variety <= 1.0:
        raise UsageError.at(
            "--variety", f"a variety of {variety:g} is out of range", "give a number from 0 to 1"
        )
    return variety


def check_period(period: Period | None, alignment: int) -> Period | None:
    """Return the period; raise UsageError unless each is a positive multiple of the alignment."""
    for length in period or ():
        if length is not None and (length <= 0 or length % alignment):
            less, more = length // alignment * alignment, -(-length // alignment) * alignment
            fits = f"{less} or {more}" if less > 0 else f"{max(more, alignment)}"
            raise UsageError(
                f"a side of {length} texels cannot repeat: this material needs multiples of "
                f"{alignment}",
                remedy=f"give {fits}",
            )
    return period


@dataclass(frozen=True)
class Span:
    """Texels [start, stop) along one axis."""

    start: int
    stop: int

    def grown(self, margin: int) -> Span:
        """The span extended by `margin` texels at both ends."""
        return Span(self.start - margin, self.stop + margin)

    def doubled(self) -> Span:
        """The span in texels of the next finer level."""
        return Span(2 * self.start, 2 * self.stop)

    @property
    def size(self) -> int:
        """Number of texels."""
        return self.stop - self.start

    def within(self, outer: Span) -> slice:
        """Slice of this span in an array that covers `outer`."""
        return slice(self.start - outer.start, self.stop - outer.start)


# The fixed grid of blocks that the plane is cut into, and the blocks that a rectangle covers.

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
            block = Rectangle(columns[0], rows[0], grid.width, grid.height)
            yield BlockPart(block, (rows[1], columns[1]), (rows[2], columns[2]))


def _runs(
    start: int, length: int, side: int, period: int | None
) -> Iterator[tuple[int, slice, slice]]:
    """Parts along one axis: the block's first texel, and slices of block and rectangle."""
    done = 0
    while done < length:
        place = start + done
        if period is not None:
            place %= period
        block = place // side * side
        size = min(block + side - place, length - done)
        if period is not None:
            size = min(size, period - place)
        yield block, slice(place - block, place - block + size), slice(done, done + size)
        done += size
