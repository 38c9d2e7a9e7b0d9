"""The field by example is a pure function of place."""

import random
import subprocess
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import plain_loops as plain
import pytest
import torch
from exemplars import PERIODS, a_coloured_example, an_example, blobs, exemplar, ordered, varied
from materials import a_material
from plain_loops import DIAGONALS, PHASE_SHIFT

from matcap.errors import UsageError
from matcap.example.blend import BAND_LEVELS, BANDS, ExemplarBands, Nodes, Votes, bands_of, blended
from matcap.example.candidates import (
    COST_BITS,
    DIMENSIONS,
    LARGEST,
    LIMIT,
    PLANES,
    TAPS,
    Basis,
    Frame,
    project,
)
from matcap.example.coordinates import coordinates, correct
from matcap.example.example import Example, coarsened
from matcap.example.index import PENALTY_BITS, Level, build_index, prepare
from matcap.field.field import read_source
from matcap.field.plane import Grid, Rectangle
from matcap.synth.plan import open_field
from matcap.synth.request import SynthRequest

# The field by example is one function of texel and seed, made of the exemplar's own pieces.

_HALF = 0.4
_KINDS = {
    "blobs": an_example,
    "bricks": ordered,
    "large-blobs": partial(varied, an_example, _HALF),
    "large-bricks": partial(varied, ordered, _HALF),
}
EXAMPLES = pytest.mark.parametrize("example", _KINDS.values(), ids=_KINDS, indirect=True)


@pytest.mark.parametrize(
    ("example", "place"),
    [
        (_KINDS["blobs"], 2**31),
        (_KINDS["bricks"], 2**40 - 300),
        (_KINDS["large-blobs"], 0),
        (_KINDS["large-bricks"], 2**40 - 300),
        (partial(varied, an_example, 0.0), 2**31),
    ],
    ids=[*_KINDS, "repeated"],
    indirect=["example"],
)
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
def test_seeds_give_different_fields(example):
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
    with pytest.raises(UsageError, match="multiples of"):
        an_example().source(0, (an_example().alignment + 1, None))
    with pytest.raises(UsageError, match="seed"):
        an_example().source(2**63)


def test_a_field_correlates_with_the_texels_it_places():
    example = an_example()
    area = Rectangle(0, 0, 64, 48)
    maps, places = example.maps(9, area, None), example.places(9, area, None)
    x, y = places[..., 0].astype(int), places[..., 1].astype(int)
    shown = example.exemplar.stacked()[:, y, x]
    for found, own in zip(maps, shown, strict=True):
        assert np.corrcoef(found.ravel(), own.ravel())[0, 1] > 0.8
    # Heights are blended, about the exemplar's own level.
    height = example.exemplar.height
    assert abs(maps[5].mean() - height.mean()) < height.std() and height.mean() > 3.0 * height.std()


def test_patches_have_many_texels():
    places = an_example().places(9, Rectangle(0, 0, 256, 256), None).astype(int)
    assert 0.7 < (np.diff(places, axis=1) == [1, 0]).all(-1).mean() < 0.99


def test_patches_hardly_begin_at_texels_without_confidence():
    doubted = blobs()
    trust = np.ones_like(doubted.confidence)
    trust[:, :, 88:] = 0.0
    example = Example.of(replace(doubted, confidence=trust))
    assert (example.places(4, Rectangle(0, 0, 300, 300), None)[..., 0] < 96).mean() > 0.9
    free = Example.of(doubted).places(4, Rectangle(0, 0, 300, 300), None)[..., 0]
    assert (free < 96).mean() < 0.8


def test_at_least_half_of_the_places_have_no_placement_cost():
    """A third is well seen, the rest worse and worse."""
    doubted = blobs()
    trust = np.ones_like(doubted.confidence)
    trust[:, :, 58:] = np.linspace(0.6, 0.2, 118, dtype=np.float32)
    priced = build_index(replace(doubted, confidence=trust), ()).penalty > 0
    assert 0.4 < priced.mean() <= 0.5 and not priced[:, :22].any() and priced[:, 23:].all()


def test_a_mark_that_occurs_once_is_left_out_and_reported():
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


def test_a_lattice_neither_drifts_nor_breaks():
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
        assert np.sqrt((apart**2).mean()) < 0.05 and abs(apart.mean()) < 0.02


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


def test_a_bent_lattice_is_followed():
    example = ordered()
    x = np.arange(30, 210)
    phases = example.index.lattice.phases(x, np.full(x.shape, 100))[:, 1].astype(float) / 2**16
    phase = (phases - 0.1 * np.sin(x / 90.0)) % 1.0
    phase = np.angle(np.exp(2j * np.pi * phase)) / (2 * np.pi)
    assert np.ptp(np.unwrap(2 * np.pi * phase)) / (2 * np.pi) < 0.06


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
def test_the_field_equals_the_plain_implementation(example, monkeypatch):
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


def test_a_field_by_example_needs_no_torch():
    modules = "matcap.example.exemplar, matcap.synth.stream, matcap.relight.texture"
    modules += ", matcap.capture.report, matcap.capture.run"  # photographs are read meanwhile
    program = f"import sys, {modules}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0


# No integer of the field by example can overflow: by bounds, and at them, in a million draws.
#
# Every reference is in int64, where nothing of this could.

INT16, INT32 = 2**15 - 1, 2**31 - 1
SIDE = 1024  # places of a draw: a million of them
MOST_PRICE = 255**2 << PENALTY_BITS
MOST_TURN = 2**15 >> PHASE_SHIFT
SIMILAR_SHIFT = 2  # of rule 3


def test_the_largest_sums_fit() -> None:
    difference = 3 * 2 * LARGEST
    assert difference <= INT16
    seam = DIMENSIONS * difference**2
    continued = len(DIAGONALS) * seam + 2 * MOST_TURN**2 + MOST_PRICE
    # A k-coherence candidate's sum ends at the first diagonal that exceeds a continuation's cost.
    assert continued + (seam << SIMILAR_SHIFT) + 2 * MOST_TURN**2 + MOST_PRICE < INT32
    assert TAPS * LIMIT * LIMIT < 2**24  # exact in float32, too


def extreme(draw: np.random.Generator) -> Level:
    """A level whose every number is as large as it may be, in one direction or the other."""
    ends = np.array([-LARGEST, LARGEST], np.int16)
    return Level(
        spacing=2,
        frame=Frame(8, 8, SIDE - 9, SIDE - 9),
        bits=0,
        appearance=draw.choice(ends, (SIDE, SIDE, DIMENSIONS)),
        similar_bits=1,
        similar_shift=SIMILAR_SHIFT,
        similar=draw.integers(8, SIDE - 10, (SIDE // 2, SIDE // 2, 2)).astype(np.int16),
        placement_cost=np.full((SIDE >> COST_BITS, SIDE >> COST_BITS), MOST_PRICE, np.int32),
        phases=draw.choice(np.array([0, -(2**15)], np.int16), (SIDE, SIDE, 2)),
    )


def test_a_million_costs_are_those_of_wider_integers() -> None:
    draw = np.random.default_rng(0)
    level = extreme(draw)
    places = draw.integers(8, SIDE - 9, (SIDE, SIDE, 2)).astype(np.int32)
    wanted = [
        draw.choice(np.array([-3, 3], np.int32) * LARGEST, (SIDE, SIDE, DIMENSIONS))
        for _ in DIAGONALS
    ]
    ordered = draw.choice(np.array([0, -(2**15)], np.int16), (SIDE, SIDE, 2))
    found = plain._cost(level, places, wanted, ordered, similar=True)
    x, y = places[..., 0], places[..., 1]
    expected = np.full((SIDE, SIDE), MOST_PRICE, np.int64)
    for (down, across), target in zip(DIAGONALS, wanted, strict=True):
        there = level.appearance[y + 2 * down, x + 2 * across].astype(np.int64)
        expected += np.square(3 * there - target).sum(-1) << SIMILAR_SHIFT
    assert level.phases is not None
    half = level.phases[y, x] != ordered
    expected += MOST_TURN**2 * half.sum(-1)
    assert np.array_equal(found, expected)
    assert expected.max() > 0.9 * INT32  # the plain form's integers are wider, too


@pytest.mark.parametrize("form", [plain.correct, correct])
def test_correction_at_the_bounds_stays_where_places_may_lie(form) -> None:
    draw = np.random.default_rng(1)
    level = extreme(draw)
    places = draw.integers(8, SIDE - 9, (96, 96, 2)).astype(np.int16)
    odd = np.arange(96) % 2 == 1
    phases = draw.choice(np.array([0, -(2**15)], np.int16), (96, 96, 2))
    found = form(places, level, odd, odd, 1, phases)
    assert np.array_equal(found, plain.correct(places, level, odd, odd, 1, phases))
    frame = level.frame
    assert frame.left <= found[..., 0].min() and found[..., 0].max() <= frame.right
    assert frame.top <= found[..., 1].min() and found[..., 1].max() <= frame.bottom


@pytest.mark.parametrize("project", [project, plain.project])
def test_the_largest_features_are_projected_exactly(project) -> None:
    draw = np.random.default_rng(2)
    basis = Basis(np.full((DIMENSIONS, TAPS), LIMIT, np.int8), 0, 1)
    features = np.full((PLANES, 32, 48), LIMIT, np.int16)
    assert np.all(project(features, basis) == LARGEST)
    signs = draw.choice(np.array([-1, 1], np.int16), (PLANES, 32, 48))
    # All sums are multiples of 127^2, and shifted down so far that none is clipped.
    found = project(features * signs, Basis(basis.weights, 13, 1))
    around = np.pad((features * signs).astype(np.int64), ((0, 0), (2, 2), (2, 2)), mode="symmetric")
    sums = sum(around[:, y : y + 32, x : x + 48].sum(0) for y in range(5) for x in range(5))
    assert np.array_equal(found[..., 0], (LIMIT * sums) >> 13)


# Maps are the exemplar's where nothing was rearranged, and join where something was.

SIZE = (300, 120)  # texels of the halves


UNLIKE = (*[0.0] * (BANDS - 1), 1.0)


def halves(piece, left, right, alike=UNLIKE):
    """(8 or 6, H, W) maps of a field that shows a piece of an exemplar left of its middle, and
    another right of it: what is added to a texel's place there; and how it is without blending.
    """
    area = Rectangle(0, 0, *SIZE)
    shown = ExemplarBands(tuple(piece.stacked()), bands_of(piece), alike, 0)

    def places(x, y):
        side = np.where((x < SIZE[0] // 2)[..., None], left, right)
        return np.stack([x, y], axis=-1) + side

    votes = []
    for band in range(BANDS):
        one = Votes.of(band, area, None, 0, 1)
        wanted = one.wanted
        y, x = np.mgrid[: wanted.height, : wanted.width]
        votes.append((one, one.predicted(places(x + wanted.x, y + wanted.y), area)))
    y, x = np.mgrid[: area.height, : area.width]
    own = places(x, y)
    found = blended(shown, area, own.astype(np.int16), votes)
    return found, piece.stacked()[:, own[..., 1], own[..., 0]]


@pytest.mark.parametrize("example", [an_example, a_coloured_example, ordered], indirect=True)
@pytest.mark.parametrize("period", [None, (176, 144), (48, 80)])
def test_the_compiled_loop_equals_the_plain_one_bit_for_bit(example, period, monkeypatch):
    area = Rectangle(-37, 501, 90, 70)
    found = example.maps(3, area, period)
    monkeypatch.setattr("matcap.example.example.blended", plain.blended)
    assert np.array_equal(found, example.maps(3, area, period))


def test_compiled_blending_equals_the_plain_one(monkeypatch):
    monkeypatch.setattr("matcap.example.example._GRID", 128)
    example = Example.of(blobs())
    area = Rectangle(11, -23, 90, 70)
    found = example.maps(3, area, None)
    monkeypatch.setattr("matcap.example.example.blended", plain.blended)
    assert np.array_equal(found, example.maps(3, area, None))


def test_bands_add_up_to_what_is_shown():
    piece = blobs(75, 58)
    bands = bands_of(piece)
    logs = np.zeros((58, 75, 8), np.float32)
    maps = piece.stacked()
    logs[..., :6] = np.moveaxis(np.concatenate([np.log2(maps[:4]), maps[4:]]), 0, -1)
    logs[..., :6] -= logs[..., :6].mean(axis=(0, 1))
    here = np.stack(np.meshgrid(np.arange(75), np.arange(58)), axis=-1)
    total = sum(band.scale * plain._band_at(band.values, band.bits + 1, 0, here) for band in bands)
    # Bands are kept in 2^-15 of their largest value.
    assert np.abs(total - logs).max() < 3e-4 * np.abs(logs).max(axis=(0, 1)).max()
    smooth = plain.smooth(logs)
    rest = sum(
        plain._band_at(band.values, band.bits + 1, 0, here) * band.scale for band in bands[1:]
    )
    assert np.abs(rest - smooth).max() < 3e-4 * np.abs(logs).max()


def test_texels_away_from_a_seam_are_the_exemplars_bit_for_bit():
    found, plainly = halves(blobs(500, 300), (90, 80), (90, 80))
    assert np.array_equal(found, plainly)
    found, plainly = halves(blobs(500, 300), (90, 80), (150, 100))
    changed = (found != plainly).any(axis=(0, 1))
    far = 3 << (BANDS - 2)  # nodes reach one and a half steps of 2^(bands - 1) texels
    middle = SIZE[0] // 2
    assert changed[middle - 8 : middle + 8].all()
    assert not changed[: middle - far].any() and not changed[middle + far :].any()


def test_a_step_at_a_seam_becomes_gradual():
    step = np.where(np.arange(800) < 400, -0.7, 0.7)[None].repeat(300, axis=0)
    found, plainly = halves(exemplar(np.stack([step] * 4)), (90, 80), (400, 80))
    for index in (0, 3, 5):
        across = np.abs(np.diff(found[index][60])).max()
        assert across < 0.08 * np.abs(np.diff(plainly[index][60])).max()
        assert np.array_equal(found[index][60, [0, -1]], plainly[index][60, [0, -1]])


def test_blending_keeps_contrast():
    """Of unrelated pieces: their mean has seven tenths of it. And none is added to related ones."""
    piece, seam = blobs(900, 400), slice(SIZE[0] // 2 - 2, SIZE[0] // 2 + 2)

    def kept(alike):
        found, plainly = halves(piece, (100, 100), (431, 217), alike)
        return np.array([found[i][:, seam].std() / plainly[i][:, seam].std() for i in range(5)])

    assert (kept(UNLIKE) > 0.92).all() and (kept((1.0,) * BANDS) < 0.9).all()
    for example, low, high in ((an_example(), 0.1, 0.4), (ordered(), 0.7, 1.0)):
        found = example._ready.shown.correlations
        assert low < np.mean(found[:4]) < high and found[-1] == 1.0


def test_seams_cast_no_steeper_steps_than_the_exemplar_has():
    for example in (an_example(), ordered()):
        height = example.maps(2, Rectangle(0, 0, 300, 300), None)[5]
        own = example.exemplar.height[0]
        for axis in (0, 1):
            steps, usual = (np.abs(np.diff(one, axis=axis)) for one in (height, own))
            assert np.quantile(steps, 0.999) < 1.15 * np.quantile(usual, 0.999)


@pytest.mark.parametrize("period", [None, 16, 48, 80, 112, 2**40])
@pytest.mark.parametrize("band", range(BANDS))
def test_nodes_repeat_with_the_field_and_weigh_one(band, period):
    spacing, unit = 1 << band, 1 << BAND_LEVELS[band]
    far = 2**39 if period is None else 5 * period
    axis = Nodes.of(-far, 200, spacing, unit, period)
    assert np.abs(axis.weights.sum(axis=1) - 1.0).max() < 1e-6 and axis.weights.min() >= 0.0
    nearest = axis.at[axis.first + 1] - (np.arange(200) - far)
    assert np.abs(nearest).max() <= max(spacing, unit) and not (axis.at % unit).any()
    again = Nodes.of(-far + (period or spacing), 200, spacing, unit, period)
    assert np.array_equal(axis.weights, again.weights)
    assert np.array_equal(axis.at + (period or spacing), again.at)


def test_parts_equal_the_whole_with_small_patches():
    example = replace(an_example(), variety=1.0)
    whole = example.maps(6, Rectangle(-90, -70, 300, 200), None)
    part = example.maps(6, Rectangle(-11, 13, 71, 40), None)
    assert np.array_equal(part, whole[:, 83:123, 79:150])


def test_a_field_by_example_refuses_cuda_and_accepts_the_cpu(tmp_path):
    path = tmp_path / "blobs.matcap"
    a_material("blobs", example=an_example()).save(path)
    asked = SynthRequest(path, Rectangle(0, 0, 8, 8), device="cpu")
    open_field(asked)
    with pytest.raises(UsageError, match="--device: only the decoder"):
        open_field(replace(asked, device="cuda"))
