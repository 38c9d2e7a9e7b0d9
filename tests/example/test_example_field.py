"""The field by example is one function of texel and seed, made of the exemplar's own pieces."""

import random
import subprocess
import sys
from dataclasses import replace

import numpy as np
import plain_loops as plain
import pytest
import torch
from exemplars import PERIODS, an_example, blobs, ordered

from matcap.errors import UsageError
from matcap.example.coordinates import coordinates
from matcap.example.example import Example, coarsened
from matcap.example.index import build_index
from matcap.example.lookup import prepare
from matcap.field.blocks import Grid
from matcap.field.field import read_source
from matcap.field.plane import Rectangle

_HALF = 0.4
_KINDS = {
    "blobs": an_example(),
    "bricks": ordered(),
    "large-blobs": an_example().varied(_HALF),
    "large-bricks": ordered().varied(_HALF),
}
EXAMPLES = pytest.mark.parametrize("example", _KINDS.values(), ids=_KINDS)


@pytest.mark.parametrize(
    "example", [*_KINDS.values(), an_example().varied(0.0)], ids=[*_KINDS, "repeated"]
)
@pytest.mark.parametrize("place", [0, 2**31, 2**40 - 300])
def test_any_rectangle_order_and_count_of_workers_gives_the_same_bits(example, place):
    source = replace(example.source(5), grid=Grid(96, 64))
    area = Rectangle(place - 40, -place + 30, 260, 170)
    whole = read_source(source, area, 1).stacked()
    draws = random.Random(place)
    for _ in range(6):
        x, y = draws.randrange(area.width), draws.randrange(area.height)
        width, height = draws.randint(1, area.width - x), draws.randint(1, area.height - y)
        part = Rectangle(area.x + x, area.y + y, width, height)
        found = read_source(source, part, draws.randint(1, 3)).stacked()
        assert torch.equal(found, whole[:, y : y + height, x : x + width])


@EXAMPLES
def test_other_blocks_are_the_same_field(example):
    area = Rectangle(-30, 20, 150, 90)
    one, other = (
        read_source(replace(example.source(5), grid=grid), area, 2).stacked()
        for grid in (Grid(64, 32), Grid(512, 256))
    )
    assert torch.equal(one, other)


@EXAMPLES
def test_seeds_are_other_pieces(example):
    one, other = (example.maps(seed, Rectangle(0, 0, 96, 96), None) for seed in (1, 2))
    assert np.abs(one - other).mean() > 0.3 * one.std(axis=(1, 2)).mean()


@EXAMPLES
# Odd multiples of the alignment: places of the coarsest level meet that are corrected together.
@pytest.mark.parametrize("period", [(80, 48), (80, None), (None, 48)])
def test_a_field_repeats_exactly_where_it_is_asked_to(example, period):
    maps = example.maps(3, Rectangle(-33, 7, 200, 150), period)
    columns, rows = period
    if columns:
        assert np.array_equal(maps[:, :, :-columns], maps[:, :, columns:])
    if rows:
        assert np.array_equal(maps[:, :-rows], maps[:, rows:])
    assert not np.array_equal(maps[:, :, :-16], maps[:, :, 16:])


def test_periods_and_seeds_out_of_range_are_refused():
    with pytest.raises(UsageError, match="multiple of"):
        an_example().source(0, (an_example().alignment + 1, None))
    with pytest.raises(UsageError, match="seed"):
        an_example().source(2**63)


def test_texels_are_the_exemplars_about_its_own_level():
    example = an_example()
    area = Rectangle(0, 0, 64, 48)
    maps, places = example.maps(9, area, None), example.places(9, area, None)
    x, y = places[..., 0].astype(int), places[..., 1].astype(int)
    shown = example.exemplar.stacked()[:, y, x]
    for found, own in zip(maps, shown, strict=True):
        assert np.corrcoef(found.ravel(), own.ravel())[0, 1] > 0.8
    # Heights are blended, about the exemplar's own level.
    height = example.exemplar.height
    assert abs(maps[5].mean() - height.mean()) < height.std()
    assert height.mean() > 3.0 * height.std()


def test_pieces_are_of_many_texels():
    places = an_example().places(9, Rectangle(0, 0, 256, 256), None).astype(int)
    joined = (np.diff(places, axis=1) == [1, 0]).all(-1)
    assert 0.7 < joined.mean() < 0.99


def test_no_piece_begins_where_nothing_is_known():
    doubted = blobs()
    trust = np.ones_like(doubted.confidence)
    trust[:, :, 88:] = 0.0
    example = Example.of(replace(doubted, confidence=trust))
    columns = example.places(4, Rectangle(0, 0, 300, 300), None)[..., 0]
    assert (columns < 96).mean() > 0.9
    free = Example.of(doubted).places(4, Rectangle(0, 0, 300, 300), None)[..., 0]
    assert (free < 96).mean() < 0.8


def test_half_of_a_piece_costs_nothing_however_little_it_is_trusted():
    """A third is well seen, the rest worse and worse."""
    doubted = blobs()
    trust = np.ones_like(doubted.confidence)
    trust[:, :, 58:] = np.linspace(0.6, 0.2, 118, dtype=np.float32)
    priced = build_index(replace(doubted, confidence=trust), ()).penalty > 0
    assert 0.4 < priced.mean() <= 0.5
    assert not priced[:, :22].any() and priced[:, 23:].all()


def test_a_mark_that_occurs_once_is_left_out_and_told():
    marked = blobs()
    marked.diffuse[:, 60:84, 60:84] = 0.0
    marked.roughness[:, 60:84, 60:84] = 1.0
    example = Example.of(marked)
    assert 0.005 < example.index.left_out < 0.1 and an_example().index.left_out < 0.005
    maps = example.maps(4, Rectangle(0, 0, 400, 400), None)
    usual = 24 * 24 / (176 * 144)
    assert (maps[4] == 1.0).mean() < 0.05 * usual  # 0.4 if it were drawn like any other place


def test_a_broad_stain_is_left_out_and_many_specks_are_not():
    """Its texels have matches among each other; specks belong to the material."""
    stained, specked = blobs(352, 288), blobs(352, 288)
    y, x = np.mgrid[:288, :352]
    stained.diffuse[:] *= 1.0 - 0.7 * np.exp(-((x - 250) ** 2 + (y - 180) ** 2) / (2 * 24.0**2))
    for row in range(20, 288, 60):
        for column in range(20, 352, 60):
            specked.diffuse[:, row : row + 14, column : column + 14] = 0.0
    example = Example.of(stained)
    assert 0.01 < example.index.left_out < 0.1 and Example.of(specked).index.left_out < 0.01
    places = example.places(4, Rectangle(0, 0, 400, 400), None).astype(np.int64)
    inside = np.hypot(places[..., 0] - 250, places[..., 1] - 180) < 24.0
    assert inside.mean() < 0.1 * np.pi * 24.0**2 / (352 * 288)


def test_order_neither_drifts_nor_breaks():
    """Phases of what is shown, against those of the ideal lattice, 16384 texels apart."""
    example = ordered()
    lattice = example.index.lattice
    assert lattice is not None
    assert [1 / wave[k] for k, wave in enumerate(lattice.waves)] == pytest.approx(PERIODS, rel=0.01)
    for x, y in ((0, 0), (16384, -16384), (2**40 - 128, 2**39)):
        places = example.places(3, Rectangle(x, y, 96, 96), None).astype(np.int64)
        shown = lattice.phases(places[..., 0], places[..., 1])
        wanted = lattice.ideal_phases(
            3, np.arange(x, x + 96)[None, :], np.arange(y, y + 96)[:, None], (None, None)
        )
        apart = (shown - wanted).astype(float) / 2**16  # turns, wrapped by 16 bits
        assert np.sqrt((apart**2).mean()) < 0.05
        assert abs(apart.mean()) < 0.02


def joints(example, x, y, side):
    """Turns from a joint to (x, y) along x and y, by the waves of the relief that is shown."""
    height = example.maps(3, Rectangle(x, y, side, side), None)[5]
    height = height - height.mean()
    # A window without leakage from the other wave or from harmonics.
    window = np.blackman(side)
    found = []
    for wave in example.index.lattice.waves:
        columns, rows = np.arange(side), np.arange(side)[:, None]
        turns = wave[0] * columns + wave[1] * rows
        carried = height * np.exp(-2j * np.pi * turns) * window * window[:, None]
        # Joints are lowest: half a turn from where the wave is highest.
        found.append(np.angle(-carried.sum()) / (2 * np.pi))
    return np.array(found)


@pytest.mark.parametrize(
    ("size", "periods"), [((240, 200), PERIODS), ((620, 560), (72.0, 87.0))], ids=["small", "large"]
)
def test_a_lattice_keeps_its_phase_over_sixteen_thousand_texels(size, periods):
    """Measured in the relief that is shown, not in places: a tenth of a period is a fault."""
    example = ordered(*size, periods)
    waves = np.array(example.index.lattice.waves)
    assert [1 / wave[k] for k, wave in enumerate(waves)] == pytest.approx(periods, rel=0.01)
    side = 5 * round(max(periods))
    start = joints(example, 0, 0, side)
    for x, y in ((16384, 0), (0, -16384), (16384, 16384)):
        drift = joints(example, x, y, side) - start - waves @ (x, y)
        assert np.abs((drift + 0.5) % 1.0 - 0.5).max() < 0.1


def test_order_is_found_where_it_was_bent():
    example = ordered()
    x = np.arange(30, 210)
    phases = example.index.lattice.phases(x, np.full(x.shape, 100))[:, 1].astype(float) / 2**16
    bend = 0.1 * np.sin(x / 90.0)
    apart = (phases - bend) % 1.0
    apart = np.angle(np.exp(2j * np.pi * apart)) / (2 * np.pi)
    assert np.ptp(np.unwrap(2 * np.pi * apart)) / (2 * np.pi) < 0.06


def test_detail_is_read_at_the_exemplars_own_resolution(monkeypatch):
    monkeypatch.setattr("matcap.example.example._GRID", 100)
    fine = blobs(192, 160)
    example = Example.of(fine)
    area = Rectangle(-21, 13, 90, 70)
    places = example.places(6, area, None).astype(int)
    assert (places[:, :, 0] & 1 == (np.arange(-21, 69) & 1)).all()
    assert (places[:, :, 1] & 1 == (np.arange(13, 83) & 1)[:, None]).all()
    whole = example.maps(6, Rectangle(-40, 0, 150, 100), None)
    assert np.array_equal(example.maps(6, area, None), whole[:, 13:83, 19:109])
    assert coarsened(fine, 1).size == (96, 80) and example.alignment % 2 == 0


@EXAMPLES
def test_the_plain_form_is_the_field(example, monkeypatch):
    lookup = prepare(example.exemplar, example.index, example.variety)
    draws = random.Random(3)
    for period in (None, (80, 48), (None, 112), None):
        far = draws.choice([100, 2**40 - 100])
        x, y = (draws.randint(-far, far) for _ in range(2))
        area = Rectangle(x, y, draws.randint(1, 40), draws.randint(1, 40))
        seed = draws.randint(-(2**63), 2**63 - 1)
        found = example.places(seed, area, period)
        with monkeypatch.context() as patched:
            patched.setattr("matcap.example.coordinates.correct", plain.correct)
            expected = coordinates(lookup, seed, {0: area}, period)[0]
        assert np.array_equal(found, expected)


def test_it_needs_no_torch():
    modules = "matcap.example.exemplar, matcap.synth.fields, matcap.synth.stream"
    program = f"import sys, {modules}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0
