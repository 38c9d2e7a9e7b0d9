"""White noise as a pure function of (seed, channel, x, y), exact anywhere in [-2^40, 2^40].

Independent uniform numbers of zero mean and unit variance from a counter-based hash of 64-bit
integers [steele2014]: h(h(c g + k1) xor h(r g + k2)) at column c and row r, with keys k1, k2 of the
seed. The inner hashes are computed once a column and once a row. Each hash gives four channels of
16 bits.

Integers are torch.int64, whose products and sums wrap modulo 2^64 on every device.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from matcap.space.patch import Patch

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
