"""Lattice coordinates for the decoder, a pure function of (seed, x, y), exact in [-2^40, 2^40].

For materials with long-range order (weaves, knits, tiles, planks). Noise through a network of
finite reach can only keep order over that reach; what every texel knows keeps it for ever (after
Bergmann et al. 2017, "Learning Texture Manifolds with the Periodic Spatial GAN"). Two kinds of
channel, both of zero mean and unit variance:

- *waves*: cosine and sine of a plane wave. The phase is an integer, a 2^64th of a turn, so it
  neither drifts nor loses digits far away. The seed moves it.
- *cells*: noise that is constant over each cell of the waves' lattice. Tiles, planks and threads
  differ from piece to piece and end sharply; a convolution of white noise ends nowhere.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from matcap.space.noise import keys, noise_at, shift, wrap64
from matcap.space.patch import Patch
from matcap.statistics.lattice import Wave

WAVE_CHANNELS = 12  # cosine and sine of six harmonics
CELL_CHANNELS = 4  # for a material that has waves

_ORDERS_OF_ONE = ((1,), (2,), (3,), (4,))
_ORDERS_OF_TWO = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2))
_FINEST = 0.36  # cycles per texel: finer waves would alias
_PHASES, _CELLS = 0x94D049BB133111EB, 0xBF58476D1CE4E5B9  # set their seeds apart from the noise's


def order_field(patch: Patch, waves: tuple[Wave, ...], cells: int) -> Tensor:
    """(WAVE_CHANNELS + cells, height, width) float32: waves, then cells.

    Args:
        patch: its seed moves the phases and draws the cells. What is too fine for texels of its
            level is zero, not aliased; each wave is moved to the nearest one that fits its period.
        waves: at most two; absent ones are zero.
        cells: channels of noise for every cell.
    """
    field = wave_field(patch, waves)
    return torch.cat([field, cell_field(patch, waves, cells)]) if cells else field


def wave_field(patch: Patch, waves: tuple[Wave, ...]) -> Tensor:
    """(WAVE_CHANNELS, height, width) float32: cosine and sine of every wave, unit variance.

    Besides the waves themselves their sums, differences and doubles, which a pattern on the
    lattice is made of and a network would otherwise have to multiply out.

    The arguments are order_field's.
    """
    scale = 2**patch.level
    along_x, along_y = patch.along
    columns, rows = patch.places()
    start = keys(wrap64(patch.seed ^ _PHASES), 2).tolist()
    field = torch.zeros(WAVE_CHANNELS, *patch.shape, device=patch.device)
    for index, (orders, fx, fy) in enumerate(_harmonics(waves)):
        if max(abs(fx), abs(fy)) * scale > _FINEST:
            continue
        step_x = step_y = offset = 0
        for order, wave, begin in zip(orders, waves, start, strict=False):
            step_x += order * _turns(wave.fx, along_x)
            step_y += order * _turns(wave.fy, along_y)
            offset += order * begin
        # A texel's centre lies (scale - 1) / 2 texels of level 0 after its first one's.
        centre = wrap64((step_x + step_y) * (scale - 1)) >> 1
        turns = (
            (columns * wrap64(step_x * scale))[None, :]
            + (rows * wrap64(step_y * scale))[:, None]
            + wrap64(offset + centre)
        )
        # 24 bits of phase: what float32 holds exactly, and 4e-7 of a radian.
        phase = shift(turns, 40).to(torch.float32) * (2.0 * math.pi / 2**24)
        field[2 * index] = phase.cos() * math.sqrt(2.0)
        field[2 * index + 1] = phase.sin() * math.sqrt(2.0)
    return field


def cell_field(patch: Patch, waves: tuple[Wave, ...], channels: int) -> Tensor:
    """(channels, height, width) float32 noise, constant over each cell of the waves' lattice.

    A cell is where every wave has made the same number of whole turns. The arguments are
    order_field's.
    """
    scale = 2**patch.level
    if not waves or any(max(abs(w.fx), abs(w.fy)) * scale > _FINEST for w in waves):
        return torch.zeros(channels, *patch.shape, device=patch.device)
    columns, rows = (
        [coordinate * scale for coordinate in line.tolist()] for line in patch.places("cpu")
    )
    start = keys(wrap64(patch.seed ^ _PHASES), 2).tolist()
    counts, repeats = [], []
    for wave, begin in zip(waves, start, strict=False):
        step_x, step_y = (
            _turns(f, p) for f, p in zip((wave.fx, wave.fy), patch.along, strict=True)
        )
        offset = begin + (step_x + step_y) * (scale - 1) // 2  # as in wave_field: a texel's centre
        counts.append(
            _whole_turns([step_x * c + offset for c in columns], [step_y * r for r in rows])
        )
        repeats.append(
            [
                0 if p is None else round(f * p)
                for f, p in zip((wave.fx, wave.fy), patch.along, strict=True)
            ]
        )
    if len(waves) == 1:
        counts.append(torch.zeros_like(counts[0]))
        repeats.append([0, 0])
    first, second = counts
    (one_x, one_y), (other_x, other_y) = repeats
    one, other = (one_x, other_x), (one_y, other_y)
    drawn = _drawn(wrap64(patch.seed ^ _CELLS), channels, first, second, one, other)
    return drawn.to(patch.device)


def _drawn(
    seed: int,
    channels: int,
    first: Tensor,
    second: Tensor,
    one: tuple[int, int],
    other: tuple[int, int],
) -> Tensor:
    """(channels, height, width) noise of the cells that texels lie in; arguments as for _same."""
    (left, right), (top, bottom) = (
        (int(turns.min()), int(turns.max()) + 1) for turns in (first, second)
    )
    if (right - left) * (bottom - top) > first.numel():  # where the field's ends meet
        return noise_at(seed, channels, *_same(first, second, one, other))
    # Cells are few: each one's numbers are drawn once, and looked up by its place in a table.
    firsts, seconds = torch.arange(left, right)[:, None], torch.arange(top, bottom)[None, :]
    firsts, seconds = torch.broadcast_tensors(firsts, seconds)
    numbers = noise_at(seed, channels, *_same(firsts, seconds, one, other)).flatten(1)
    index = (first - left) * (bottom - top) + (second - top)
    return numbers[:, index.flatten()].unflatten(1, index.shape)


def _whole_turns(columns: list[int], rows: list[int]) -> Tensor:
    """(rows, columns) int64: the floor of column + row, where a turn is 2^64.

    Sums are exact: the lower 64 bits are added as they wrap, and carry where the sum is less than
    what was added.
    """

    def halves(values: list[int]) -> tuple[Tensor, Tensor]:
        return (
            torch.tensor([value >> 64 for value in values], dtype=torch.int64),
            torch.tensor([wrap64(value) for value in values], dtype=torch.int64),
        )

    (column_high, column_low), (row_high, row_low) = halves(columns), halves(rows)
    low = row_low[:, None] + column_low[None, :]
    top = -(2**63)  # with the top bit flipped, signed numbers are ordered as unsigned ones
    carry = (low ^ top) < (column_low ^ top)[None, :]
    return row_high[:, None] + column_high[None, :] + carry


def _same(
    first: Tensor, second: Tensor, one: tuple[int, int], other: tuple[int, int]
) -> tuple[Tensor, Tensor]:
    """Cells (first, second), of all those that a repeat makes one the same member.

    Args:
        first, second: whole turns of each wave.
        one, other: the turns of both waves after which the field repeats, along x and along y;
            (0, 0) where it never does.
    """
    # Euclid's algorithm: the same repeats, the second of which leaves the first wave alone.
    while other[0]:
        times = one[0] // other[0]
        one, other = other, (one[0] - times * other[0], one[1] - times * other[1])
    if one[0]:
        times_here = first.div(one[0], rounding_mode="floor")
        first, second = first - times_here * one[0], second - times_here * one[1]
        rest = abs(other[1])
    else:
        rest = math.gcd(one[1], other[1])
    return first, second.remainder(rest) if rest else second


def _harmonics(waves: tuple[Wave, ...]) -> list[tuple[tuple[int, ...], float, float]]:
    """Orders and frequency of every wave channel pair."""
    orders = _ORDERS_OF_ONE if len(waves) == 1 else _ORDERS_OF_TWO
    return [
        (
            order,
            sum(n * wave.fx for n, wave in zip(order, waves, strict=True)),
            sum(n * wave.fy for n, wave in zip(order, waves, strict=True)),
        )
        for order in (orders if waves else ())
    ]


def _turns(frequency: float, period: int | None) -> int:
    """A frequency in cycles per texel as 2^64ths of a turn per texel, snapped to a period."""
    if period is None:
        return wrap64(round(frequency * 2**64))
    return wrap64(round(round(frequency * period) * 2**64 / period))
