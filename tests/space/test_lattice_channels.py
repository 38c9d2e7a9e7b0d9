"""Cells of regular order: whole, independent, the same wherever they are asked for."""

import pytest
import torch

from matcap.field.plane import Rectangle
from matcap.space.lattice_channels import (
    _PHASES,
    WAVE_CHANNELS,
    cell_field,
    lattice_field,
    wave_field,
)
from matcap.space.noise import keys, wrap64
from matcap.space.patch import Patch
from matcap.statistics.lattice import Wave

STRAIGHT = (Wave(1 / 43.3, 0.0), Wave(0.0, 1 / 42.7))
OBLIQUE = (Wave(1 / 16.7, 0.003), Wave(-0.011, 1 / 9.3))
STRIPES = (Wave(0.0, 1 / 12.3),)
LATTICES = pytest.mark.parametrize("waves", [STRAIGHT, OBLIQUE, STRIPES])


def whole_turns(waves, seed, x, y, level=0):
    """What every wave has counted at a texel, by Python's integers."""
    start = keys(wrap64(seed ^ _PHASES), 2).tolist()
    counts = []
    for wave, begin in zip(waves, start, strict=False):
        step_x, step_y = round(wave.fx * 2**64), round(wave.fy * 2**64)
        middle = (step_x + step_y) * (2**level - 1) // 2
        counts.append((step_x * 2**level * x + step_y * 2**level * y + begin + middle) >> 64)
    return tuple(counts)


def numbers_of_cells(waves, x, y, size, level=0):
    """Every cell's numbers, and that no texel of it has others."""
    field = cell_field(Patch(5, Rectangle(x, y, size, size), level=level), waves, 3)
    found = {}
    for row in range(size):
        for column in range(size):
            cell = whole_turns(waves, 5, x + column, y + row, level)
            numbers = tuple(field[:, row, column].tolist())
            assert found.setdefault(cell, numbers) == numbers
    return found


@LATTICES
@pytest.mark.parametrize("corner", [(0, 0), (-70, 2**31 - 40), (2**40 - 90, -(2**40) + 3)])
def test_a_cell_is_where_every_wave_has_made_the_same_whole_turns(waves, corner):
    found = numbers_of_cells(waves, *corner, 60)
    assert len(found) >= 4
    assert len(set(found.values())) == len(found)


def test_levels_agree_on_a_cell_s_numbers():
    fine = numbers_of_cells(OBLIQUE, 32, -64, 64)
    coarse = numbers_of_cells(OBLIQUE, 16, -32, 32, level=1)
    shared = fine.keys() & coarse.keys()
    assert len(shared) > 20
    assert all(fine[cell] == coarse[cell] for cell in shared)


@LATTICES
def test_a_rectangle_is_cut_out_of_a_larger_one(waves):
    whole = cell_field(Patch(3, Rectangle(-50, -70, 200, 160)), waves, 4)
    part = cell_field(Patch(3, Rectangle(10, -10, 64, 33)), waves, 4)
    assert torch.equal(part, whole[:, 60:93, 60:124])


@LATTICES
@pytest.mark.parametrize("period", [(160, 96), (160, None), (None, 96)])
@pytest.mark.parametrize("level", [0, 2])
def test_cells_repeat_and_stay_whole_where_the_ends_meet(waves, period, level):
    side, height = 480 >> level, 288 >> level
    field = cell_field(
        Patch(3, Rectangle(-30, 5, side, height), level=level, period=period), waves, 2
    )
    shift = [length and length >> level for length in (period[1], period[0])]
    assert torch.equal(field, field.roll([s or 0 for s in shift], (1, 2)))
    if all(period) and len(waves) == 2 and level == 0:
        (a, b), (c, d) = ((round(w.fx * period[0]), round(w.fy * period[1])) for w in waves)
        # The lattice has as many cells in one repeat as its determinant says, and no scraps.
        assert field.flatten(1).unique(dim=1).shape[1] == abs(a * d - b * c)


def test_a_block_where_far_ends_meet_is_made_of_the_same_cells():
    period = (2**14, 2**14)
    meeting = cell_field(Patch(3, Rectangle(-20, -20, 64, 64), period=period), OBLIQUE, 2)
    corner = cell_field(Patch(3, Rectangle(0, 0, 44, 44), period=period), OBLIQUE, 2)
    assert torch.equal(meeting[:, 20:, 20:], corner)


def test_cells_have_zero_mean_and_unit_variance_and_are_independent():
    cells = cell_field(Patch(1, Rectangle(0, 0, 800, 800)), (Wave(0.25, 0.0), Wave(0.0, 0.25)), 2)[
        :, ::4, ::4
    ]
    assert cells.mean(dim=(1, 2)).abs().max() < 0.02
    assert (cells.std(dim=(1, 2)) - 1.0).abs().max() < 0.02
    for other in (cells[1], cells[0].roll(1, 0), cells[0].roll(1, 1)):
        assert abs(float((cells[0] * other).mean())) < 0.02


def test_cells_too_fine_for_a_level_are_left_out():
    assert cell_field(Patch(1, Rectangle(0, 0, 8, 8), level=2), OBLIQUE, 2).abs().max() == 0
    assert cell_field(Patch(1, Rectangle(0, 0, 8, 8)), (), 2).abs().max() == 0


def test_order_is_waves_then_cells():
    patch = Patch(9, Rectangle(4, 5, 20, 10))
    field = lattice_field(patch, STRAIGHT, 3)
    assert torch.equal(field[:WAVE_CHANNELS], wave_field(patch, STRAIGHT))
    assert torch.equal(field[WAVE_CHANNELS:], cell_field(patch, STRAIGHT, 3))
    assert torch.equal(lattice_field(patch, STRAIGHT, 0), field[:WAVE_CHANNELS])
