"""Lattice channels of the decoder, a pure function of (seed, x, y), exact in [-2^40, 2^40].

For materials with long-range regularity (weaves, knits, tiles, planks). A network on noise has no
correlation beyond its receptive field; periodic inputs give it the phase of the lattice everywhere
[bergmann2017]. Two kinds of channel, both of zero mean and unit variance:

- *waves*: cosine and sine of plane waves, with a random phase by the seed (field/turns.py).
- *cells*: noise that is constant over each cell of the lattice, for tiles, planks and threads that
  differ from each other and have sharp borders.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from matcap.field.turns import Integers, same_cells, turns_per_texel, whole_turns
from matcap.space.noise import keys, noise_at, shift, wrap64
from matcap.space.patch import Patch
from matcap.statistics.lattice import Wave

WAVE_CHANNELS = 12  # cosine and sine of six harmonics
CELL_CHANNELS = 4  # for a material that has waves

_ORDERS_OF_ONE = ((1,), (2,), (3,), (4,))
_ORDERS_OF_TWO = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2))
_FINEST = 0.36  # cycles per texel: higher frequencies would alias
_PHASES, _CELLS = 0x94D049BB133111EB, 0xBF58476D1CE4E5B9  # make seeds independent of the noise's


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
        seed = wrap64(patch.seed ^ _CELLS)
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
