"""The decoder's input: noise, lattice channels and a drawing, exact anywhere."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from matcap.example.library import Integers, same_cells, turns_per_texel, whole_turns
from matcap.field.plane import Period, Rectangle
from matcap.statistics.lattice import Wave

# A rectangle of one realisation of the random field, at a mip level.


@dataclass(frozen=True)
class Patch:
    """Texels at which noise and lattice channels are computed."""

    seed: int
    """Seed of the realisation, in [-2^63, 2^63)."""
    area: Rectangle
    """Rectangle in texels of the level."""
    level: int = 0
    """Texels are 2^level times as large."""
    period: Period | None = None
    """Period in texels of level 0; None is endless."""
    device: torch.device | str = "cpu"
    """Device to compute on; values are the same on every device."""

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        return self.area.height, self.area.width

    @property
    def along(self) -> Period:
        """The period along x and along y in texels of level 0, None where endless."""
        return (None, None) if self.period is None else self.period

    def at_level(self, level: int) -> Patch:
        """This patch of level 0 at a coarser level; its coordinates are multiples of 2^level."""
        x, y = self.area.x >> level, self.area.y >> level
        width, height = self.area.width >> level, self.area.height >> level
        return replace(self, area=Rectangle(x, y, width, height), level=level)

    def places(self, device: torch.device | str | None = None) -> tuple[Tensor, Tensor]:
        """Columns (width,) and rows (height,), int64, modulo the period."""
        area = self.area
        where = self.device if device is None else device
        columns = torch.arange(area.x, area.x + area.width, dtype=torch.int64, device=where)
        rows = torch.arange(area.y, area.y + area.height, dtype=torch.int64, device=where)
        columns, rows = (
            line if length is None else line.remainder(length >> self.level)
            for line, length in zip((columns, rows), self.along, strict=True)
        )
        return columns, rows


# White noise as a pure function of (seed, channel, x, y), exact anywhere in [-2^40, 2^40].
#
# Independent uniform numbers of zero mean and unit variance from a counter-based hash of 64-bit
# integers [steele2014]: h(h(c g + k1) xor h(r g + k2)) at column c and row r, with keys k1, k2 of
# the seed. The inner hashes are computed once a column and once a row. Each hash gives four
# channels of 16 bits.
#
# Integers are torch.int64, whose products and sums wrap modulo 2^64 on every device.

_CHANNELS_PER_HASH = 4  # of 16 bits each
_GOLDEN = 0x9E3779B97F4A7C15  # 2^64 / golden ratio: the step of splitmix64
_TOP_BITS = 0x8000800080008000  # sign bits of the four 16-bit numbers in a hash
_MIX_1 = 0xBF58476D1CE4E5B9  # the multipliers of splitmix64's finaliser [steele2014]
_MIX_2 = 0x94D049BB133111EB


def wrap64(value: int) -> int:
    """The signed 64-bit integer with the same low 64 bits."""
    value &= 2**64 - 1
    return value - 2**64 if value >= 2**63 else value


def shift(value: Tensor, bits: int) -> Tensor:
    """Logical right shift of int64."""
    return (value >> bits).bitwise_and_(2 ** (64 - bits) - 1)


def _scramble(value: Tensor) -> Tensor:
    """splitmix64's finaliser [steele2014]: a bijection in which each bit affects all others."""
    value = shift(value, 30).bitwise_xor_(value).mul_(wrap64(_MIX_1))
    value = shift(value, 27).bitwise_xor_(value).mul_(wrap64(_MIX_2))
    return shift(value, 31).bitwise_xor_(value)


def keys(seed: int, count: int) -> Tensor:
    """(count,) independent 64-bit keys of a seed."""
    counter = torch.arange(1, count + 1, dtype=torch.int64)
    start = _scramble(torch.tensor(wrap64(seed + _GOLDEN), dtype=torch.int64))
    return _scramble(counter * wrap64(_GOLDEN) + start)


def noise_field(patch: Patch, channels: int) -> Tensor:
    """(channels, height, width) float32 uniform noise of zero mean and unit variance.

    In channels_last memory format.

    Args:
        patch: of level 0.
    """
    columns, rows = patch.places()
    return noise_at(patch.seed, channels, columns[None, :], rows[:, None])


def noise_at(seed: int, channels: int, columns: Tensor, rows: Tensor) -> Tensor:
    """noise_field at texels; columns and rows are int64, broadcast to (height, width)."""
    hashes = -(-channels // _CHANNELS_PER_HASH)
    chosen = keys(seed, 2 * hashes).tolist()
    # NumPy's: torch.broadcast_shapes imports PyTorch's compiler, which takes a third of a second.
    height, width = np.broadcast_shapes(columns.shape, rows.shape)
    fields = torch.empty(height, width, hashes, _CHANNELS_PER_HASH, device=columns.device)
    for index in range(hashes):
        column_hash = _scramble(columns * wrap64(_GOLDEN) + chosen[2 * index])
        row_hash = _scramble(rows * wrap64(_GOLDEN) + chosen[2 * index + 1])
        bits = _scramble(column_hash ^ row_hash)
        # With flipped sign bits, each signed 16-bit number is k - 2^15 for k in [0, 2^16).
        parts = bits.bitwise_xor_(wrap64(_TOP_BITS)).view(torch.int16)
        fields[:, :, index] = parts.reshape(height, width, _CHANNELS_PER_HASH)
    # (k + 1/2) / 2^16 - 1/2, times sqrt(12): centred, unit variance.
    fields.add_(0.5).mul_(math.sqrt(12.0) / 65536.0)
    return fields.flatten(2)[..., :channels].permute(2, 0, 1)


# Lattice channels of the decoder, a pure function of (seed, x, y), exact in [-2^40, 2^40].
#
# For materials with long-range regularity (weaves, knits, tiles, planks). A network on noise has no
# correlation beyond its receptive field; periodic inputs give it the phase of the lattice
# everywhere [bergmann2017]. Two kinds of channel, both of zero mean and unit variance:
#
# - *waves*: cosine and sine of plane waves, with a random phase by the seed (example/library.py).
# - *cells*: noise that is constant over each cell of the lattice, for tiles, planks and threads
#   that differ from each other and have sharp borders.

WAVE_CHANNELS = 12  # cosine and sine of six harmonics
CELL_CHANNELS = 4  # for a material that has waves

_ORDERS_OF_ONE = ((1,), (2,), (3,), (4,))
_ORDERS_OF_TWO = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2))
_FINEST = 0.36  # cycles per texel: higher frequencies would alias
_PHASES, _CELL_SEED = (
    0x94D049BB133111EB,
    0xBF58476D1CE4E5B9,
)  # make seeds independent of the noise's


def lattice_field(patch: Patch, waves: tuple[Wave, ...], cells: int) -> Tensor:
    """(WAVE_CHANNELS + cells, height, width) float32: waves, then cells.

    Frequencies too high for the patch's level give zero channels. With a period each wave is
    replaced by the nearest one that repeats in it.

    Args:
        patch: texels, with the seed of phases and cells.
        waves: of the lattice, at most two; channels of absent ones are zero.
        cells: channels of cell noise.
    """
    field = wave_field(patch, waves)
    return torch.cat([field, cell_field(patch, waves, cells)]) if cells else field


def wave_field(patch: Patch, waves: tuple[Wave, ...]) -> Tensor:
    """(WAVE_CHANNELS, height, width) float32: sqrt(2) times cosine and sine of every harmonic.

    Harmonics of one wave are its first four multiples, of two waves also their sum and difference.
    Arguments as in lattice_field.
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
            step_x += order * turns_per_texel(wave.fx, along_x)
            step_y += order * turns_per_texel(wave.fy, along_y)
            offset += order * begin
        # A coarse texel's centre lies (scale - 1) / 2 texels after that of its first fine texel.
        centre = wrap64((step_x + step_y) * (scale - 1)) >> 1
        turns = (
            (columns * wrap64(step_x * scale))[None, :]
            + (rows * wrap64(step_y * scale))[:, None]
            + wrap64(offset + centre)
        )
        # The upper 24 bits of the phase, which float32 represents exactly.
        phase = shift(turns, 40).to(torch.float32) * (2.0 * math.pi / 2**24)
        field[2 * index] = phase.cos() * math.sqrt(2.0)
        field[2 * index + 1] = phase.sin() * math.sqrt(2.0)
    return field


def cell_field(patch: Patch, waves: tuple[Wave, ...], channels: int) -> Tensor:
    """(channels, height, width) float32 noise, constant over each cell of the lattice.

    A cell is the set of texels at which each wave has the same number of whole turns. Arguments as
    in lattice_field.
    """
    scale = 2**patch.level
    if not waves or any(max(abs(w.fx), abs(w.fy)) * scale > _FINEST for w in waves):
        return torch.zeros(channels, *patch.shape, device=patch.device)
    first, second = _cell_numbers(patch, waves)
    period_x, period_y = patch.along
    repeat_x = _turns_of_two([wave.fx for wave in waves], period_x)
    repeat_y = _turns_of_two([wave.fy for wave in waves], period_y)

    def noise_of_cells(first: Integers, second: Integers) -> Tensor:
        cells = same_cells(first, second, repeat_x, repeat_y)
        seed = wrap64(patch.seed ^ _CELL_SEED)
        return noise_at(seed, channels, *(torch.from_numpy(numbers) for numbers in cells))

    left, top = int(first.min()), int(second.min())
    wide, high = int(first.max()) + 1 - left, int(second.max()) + 1 - top
    if wide * high > first.size:  # the patch spans the border of the period
        return noise_of_cells(first, second).to(patch.device)
    # There are fewer cells than texels: draw once a cell, then index.
    numbers = np.ogrid[left : left + wide, top : top + high]
    table = noise_of_cells(*np.broadcast_arrays(*numbers))
    index = torch.from_numpy((first - left) * high + (second - top))
    return table.flatten(1)[:, index.flatten()].unflatten(1, index.shape).to(patch.device)


def _cell_numbers(patch: Patch, waves: tuple[Wave, ...]) -> tuple[Integers, Integers]:
    """(height, width) whole turns of the first and of the second wave; 0 of an absent one."""
    scale = 2**patch.level
    columns, rows = (
        [coordinate * scale for coordinate in line.tolist()] for line in patch.places("cpu")
    )
    period_x, period_y = patch.along
    start = keys(wrap64(patch.seed ^ _PHASES), 2).tolist()
    turns = []
    for wave, begin in zip(waves, start, strict=False):
        step_x, step_y = turns_per_texel(wave.fx, period_x), turns_per_texel(wave.fy, period_y)
        offset = begin + (step_x + step_y) * (scale - 1) // 2  # to the texel's centre
        turns.append(
            whole_turns([step_x * c + offset for c in columns], [step_y * r for r in rows])
        )
    return turns[0], turns[1] if len(turns) > 1 else np.zeros_like(turns[0])


def _turns_of_two(frequencies: list[float], period: int | None) -> tuple[int, int]:
    """Whole turns of two waves in a period along an axis; 0 without one or of an absent wave."""
    turns = [0 if period is None else round(frequency * period) for frequency in frequencies]
    return turns[0], turns[1] if len(turns) > 1 else 0


def _harmonics(waves: tuple[Wave, ...]) -> list[tuple[tuple[int, ...], float, float]]:
    """For every harmonic its orders in the waves, and its frequency (fx, fy)."""
    orders = _ORDERS_OF_ONE if len(waves) == 1 else _ORDERS_OF_TWO
    return [
        (
            order,
            sum(n * wave.fx for n, wave in zip(order, waves, strict=True)),
            sum(n * wave.fy for n, wave in zip(order, waves, strict=True)),
        )
        for order in (orders if waves else ())
    ]


# The decoder's input: white noise, lattice channels and a drawing.


@dataclass(frozen=True)
class RandomField:
    """Inputs of a decoder."""

    noise: Tensor
    """(B, noise_channels, H, W) white noise."""
    waves: tuple[Tensor, ...]
    """Lattice channels of each level k, (B, WAVE_CHANNELS + cells, H / 2^k, W / 2^k)."""
    drawing: tuple[Tensor, ...] = ()
    """The drawing at each level k, (B, DRAWING_CHANNELS, H / 2^k, W / 2^k); empty without one."""

    @property
    def read_up(self) -> tuple[Tensor, ...]:
        """What each level of the way up reads besides features: the drawing, then the lattice."""
        if not self.drawing or not self.waves:
            return self.drawing or self.waves
        return tuple(torch.cat(each, 1) for each in zip(self.drawing, self.waves, strict=True))


def random_field(
    patch: Patch, noise_channels: int, waves: tuple[Wave, ...], *, levels: int, cells: int = 0
) -> RandomField:
    """Inputs of a decoder for one rectangle, as a batch of one.

    Args:
        patch: of level 0; its sides, corner and period are multiples of 2^levels.
        levels: that have lattice channels.
    """
    noise = noise_field(patch, noise_channels)[None]
    return RandomField(noise, lattice_levels(patch, waves, cells, levels))


def lattice_levels(
    patch: Patch, waves: tuple[Wave, ...], cells: int, levels: int
) -> tuple[Tensor, ...]:
    """Lattice channels of a patch at the finest `levels` levels; see RandomField.waves."""
    return tuple(lattice_field(patch.at_level(k), waves, cells)[None] for k in range(levels))
