"""The random field the decoder reads: a pure function of (seed, channel, x, y).

Two kinds of channel, both of zero mean and unit variance, exact anywhere in [-2^40, 2^40]:

- *noise*: independent uniform numbers from a counter-based hash of 64-bit integers. Column and row
  are scrambled apart and joined by one more scrambling per texel, so a rectangle costs one hash
  per texel and four channels; 16 bits each.
- *waves*: cosine and sine of a plane wave, for materials with long-range order (weaves, knits,
  tiles). Noise through a network of finite reach can only keep order over that reach; a phase
  that every texel knows keeps it for ever (after Bergmann et al. 2017, "Learning Texture Manifolds
  with the Periodic Spatial GAN"). The phase is an integer, a 2^64th of a turn, so it neither
  drifts nor loses digits far away. The seed moves it.

Integers are torch int64, whose products and sums wrap modulo 2^64 on every device.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

COORDINATE_LIMIT = 2**40
SEED_LIMIT = 2**63

WAVE_CHANNELS = 12

_ORDERS_OF_ONE = ((1,), (2,), (3,), (4,))
_ORDERS_OF_TWO = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2))
# What repeats: texels along x and along y, None for an axis that never does.
Period = tuple[int | None, int | None]

_FINEST = 0.36  # cycles per texel: finer waves would alias
_CHANNELS_PER_HASH = 4
_GOLDEN = 0x9E3779B97F4A7C15  # 2^64 / golden ratio: the step of splitmix64
_TOP_BITS = 0x8000800080008000  # of the four numbers in a hash
_MIX_1 = 0xBF58476D1CE4E5B9  # the multipliers of splitmix64's finaliser (Steele et al. 2014)
_MIX_2 = 0x94D049BB133111EB


@dataclass(frozen=True)
class Wave:
    """A plane wave of the field: cycles per texel along x (right) and y (down)."""

    fx: float
    fy: float


@dataclass(frozen=True)
class RandomField:
    """What a decoder reads.

    Attributes:
        noise: (B, noise_channels, H, W).
        waves: per level k, (B, WAVE_CHANNELS, H / 2^k, W / 2^k).
    """

    noise: Tensor
    waves: tuple[Tensor, ...]


def wrap64(value: int) -> int:
    """An integer as the signed 64-bit number with the same low 64 bits."""
    value &= 2**64 - 1
    return value - 2**64 if value >= 2**63 else value


def _shift(value: Tensor, bits: int) -> Tensor:
    """Logical right shift of int64."""
    return (value >> bits).bitwise_and_(2 ** (64 - bits) - 1)


def _scramble(value: Tensor) -> Tensor:
    """splitmix64's finaliser: a bijection of 64-bit integers in which every bit reaches all."""
    value = _shift(value, 30).bitwise_xor_(value).mul_(wrap64(_MIX_1))
    value = _shift(value, 27).bitwise_xor_(value).mul_(wrap64(_MIX_2))
    return _shift(value, 31).bitwise_xor_(value)


def _keys(seed: int, count: int) -> Tensor:
    """(count,) independent 64-bit keys of a seed."""
    counter = torch.arange(1, count + 1, dtype=torch.int64)
    start = _scramble(torch.tensor(wrap64(seed + _GOLDEN), dtype=torch.int64))
    return _scramble(counter * wrap64(_GOLDEN) + start)


def noise_field(
    seed: int,
    channels: int,
    x: int,
    y: int,
    width: int,
    height: int,
    *,
    period: Period | None = None,
    device: torch.device | str = "cpu",
) -> Tensor:
    """(channels, height, width) float32 uniform noise of zero mean and unit variance.

    In memory channels come last, as the network's convolutions like it.

    Args:
        seed: any integer in [-2^63, 2^63).
        channels: how many independent fields.
        x, y: the left top texel; y grows downwards.
        width, height: the rectangle's size in texels.
        period: (along x, along y) repeat in texels; None for what is endless.
        device: where to compute; the numbers are the same everywhere.
    """
    columns, rows = _places(x, y, width, height, period, device)
    hashes = -(-channels // _CHANNELS_PER_HASH)
    keys = _keys(seed, 2 * hashes).tolist()
    fields = torch.empty(height, width, hashes, _CHANNELS_PER_HASH, device=device)
    for index in range(hashes):
        column_hash = _scramble(columns * wrap64(_GOLDEN) + keys[2 * index])
        row_hash = _scramble(rows * wrap64(_GOLDEN) + keys[2 * index + 1])
        bits = _scramble(column_hash[None, :] ^ row_hash[:, None])
        # Read as four signed numbers, lowest bits first: k - 2^15, once the top bits are flipped.
        parts = bits.bitwise_xor_(wrap64(_TOP_BITS)).view(torch.int16)
        fields[:, :, index] = parts.reshape(height, width, _CHANNELS_PER_HASH)
    # (k + 1/2) / 2^16 - 1/2, times sqrt(12): centred, unit variance.
    fields.add_(0.5).mul_(math.sqrt(12.0) / 65536.0)
    return fields.flatten(2)[..., :channels].permute(2, 0, 1)


def wave_field(
    seed: int,
    waves: tuple[Wave, ...],
    x: int,
    y: int,
    width: int,
    height: int,
    *,
    level: int = 0,
    period: Period | None = None,
    device: torch.device | str = "cpu",
) -> Tensor:
    """(WAVE_CHANNELS, height, width) float32: cosine and sine of every wave, unit variance.

    Besides the waves themselves their sums, differences and doubles, which a pattern on the
    lattice is made of and a network would otherwise have to multiply out.

    Args:
        seed: moves the phases.
        waves: at most two; absent ones are zero.
        x, y, width, height: the rectangle, in texels of this level.
        level: texels are 2^level times as large; a wave too fine for them is zero, not aliased.
        period: in texels of level 0; each wave is moved to the nearest one that fits.
        device: where to compute; phases are the same everywhere.
    """
    scale = 2**level
    along_x, along_y = (None, None) if period is None else period
    shrunk = (along_x and along_x // scale, along_y and along_y // scale)
    columns, rows = _places(x, y, width, height, shrunk, device)
    start = _keys(wrap64(seed ^ _MIX_2), 2).tolist()
    field = torch.zeros(WAVE_CHANNELS, height, width, device=device)
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
        phase = _shift(turns, 40).to(torch.float32) * (2.0 * math.pi / 2**24)
        field[2 * index] = phase.cos() * math.sqrt(2.0)
        field[2 * index + 1] = phase.sin() * math.sqrt(2.0)
    return field


def random_field(
    seed: int,
    noise_channels: int,
    waves: tuple[Wave, ...],
    x: int,
    y: int,
    width: int,
    height: int,
    *,
    levels: int,
    period: Period | None = None,
    device: torch.device | str = "cpu",
) -> RandomField:
    """All the decoder reads for one rectangle, as a batch of one.

    x, y, width, height and the period are multiples of 2^levels; the rest as noise_field and
    wave_field.
    """
    noise = noise_field(seed, noise_channels, x, y, width, height, period=period, device=device)
    stack = tuple(
        wave_field(
            seed, waves, x >> k, y >> k, width >> k, height >> k,
            level=k, period=period, device=device,
        )[None]
        for k in range(levels)
    )  # fmt: skip
    return RandomField(noise[None], stack)


def _places(
    x: int,
    y: int,
    width: int,
    height: int,
    period: Period | None,
    device: torch.device | str,
) -> tuple[Tensor, Tensor]:
    """Columns (width,) and rows (height,) of a rectangle, within the first period."""
    columns = torch.arange(x, x + width, dtype=torch.int64, device=device)
    rows = torch.arange(y, y + height, dtype=torch.int64, device=device)
    if period is not None:
        columns, rows = (
            places if length is None else places.remainder(length)
            for places, length in zip((columns, rows), period, strict=True)
        )
    return columns, rows


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
