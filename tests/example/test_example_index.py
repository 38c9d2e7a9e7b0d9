"""The index of an exemplar, its variety and fine lattices."""

from dataclasses import replace
from functools import cache, partial

import cv2
import numpy as np
import plain_loops as plain
import pytest
import torch
from exemplars import an_example, blobs, exemplar, grained, large_blobs, ordered, reread, varied
from materials import a_material

from matcap.brdf.folder import read_mapset
from matcap.capture.exemplar.estimate import indexed
from matcap.capture.exemplar.inpaint import _discontinuity
from matcap.cli.main import main
from matcap.errors import MatcapError, UsageError
from matcap.example.candidates import (
    Frame,
    PatchSizes,
    choose_basis,
    choose_scale,
    features_of,
    find_candidates,
    frame_of,
    grid_bits,
    level_count,
    planes_of,
    project,
)
from matcap.example.coordinates import correct
from matcap.example.example import Example, halvings, summary
from matcap.example.exemplar import Exemplar
from matcap.example.fine_lattice import straightened
from matcap.example.index import prepare
from matcap.example.lattice import (
    PhasedLattice,
    _unwrapped,
    cells_of,
    measure_lattice,
    with_least_borders,
)
from matcap.example.plaid import _margins, is_plaid
from matcap.example.variety import variety_trials, with_chosen_variety, with_least_steps
from matcap.field.material import Material
from matcap.field.plane import Rectangle
from matcap.flash.geometry import FlashSetup

# The index survives its file, and the compiled loops are the plain ones.


def features():
    planes = planes_of(blobs())
    return features_of(planes, choose_scale(planes))


@pytest.mark.parametrize("example", [an_example, ordered], indirect=True)
def test_a_file_gives_back_the_same_field(example):
    again = reread(example)
    area = Rectangle(5, -9, 70, 50)
    assert np.array_equal(again.maps(3, area, None), example.maps(3, area, None))
    assert again.index.left_out == example.index.left_out


@pytest.mark.parametrize("size", [(114, 113), (97, 128)])
def test_files_of_any_exemplar_size_are_read_back(size):
    """Grids of its levels are rounded down at each, which is less than by all at once."""
    example = Example.of(blobs(*size))
    assert len(example.index.bases) > 2
    area = Rectangle(5, -9, 70, 50)
    assert np.array_equal(reread(example).maps(3, area, None), example.maps(3, area, None))


def test_damaged_indices_are_refused():
    tensors, about = ordered().stored()

    def read(tensors=tensors, **index):
        return Example.read(about | {"index": about["index"] | index}, tensors.__getitem__)

    read()
    for bad in (
        {"shifts": []},
        {"shifts": [3] * 40},
        {"shifts": [99, 3]},
        {"offsets": [0.0]},
        {"factors": [float("nan")] * 8},
        {"waves": [[0.1, 0.0], [0.2, 0.0]]},
        {"waves": [[0.0, 0.0]]},
    ):
        with pytest.raises(ValueError):
            read(**bad)
    with pytest.raises(ValueError, match="bytes"):
        read(tensors | {"index.bends": tensors["index.reluctance"]})
    beyond = np.full_like(ordered().index.similar[0].transpose(2, 0, 1), 5000)
    from matcap.example.exemplar import pack

    with pytest.raises(ValueError, match="beyond"):
        read(tensors | {"index.similar.0": pack(beyond)})


def test_too_small_an_exemplar_is_refused():
    with pytest.raises(ValueError, match="exemplar of"):
        Example.of(blobs(13, 40))


@pytest.mark.parametrize("step", [1, 2])
def test_the_compiled_projection_is_the_plain_one(step):
    found = features()
    basis = choose_basis(found, step)
    assert np.array_equal(project(found, basis), plain.project(found, basis))


@pytest.mark.parametrize("example", [an_example, ordered], indirect=True)
def test_the_compiled_correction_is_the_plain_one_from_any_beginning(example):
    random = np.random.default_rng(4)
    for level in prepare(example.exemplar, example.index).levels:
        frame = level.frame
        places = np.stack(
            [
                random.integers(frame.left, frame.right + 1, (40, 52)),
                random.integers(frame.top, frame.bottom + 1, (40, 52)),
            ],
            axis=-1,
        ).astype(np.int16)
        odd_columns, odd_rows = random.random(52) < 0.5, random.random(40) < 0.5
        phases = None
        if level.phases is not None:
            phases = random.integers(-(2**15), 2**15, (40, 52, 2)).astype(np.int16)
        found, expected = (
            form(places, level, odd_columns, odd_rows, 2, phases)
            for form in (correct, plain.correct)
        )
        assert np.array_equal(found, expected) and (found != places[16:-16, 16:-16]).any()


@pytest.mark.parametrize("count", [1, 300])
def test_the_compiled_comparison_of_blocks_is_the_plain_one(count):
    random = np.random.default_rng(6)
    donor, seen = random.standard_normal((2, 80, 90, 4)).astype(np.float32)
    for each in (donor, seen):
        each[..., 3] = 0.0  # three features
    blocks = random.integers(0, (80 - 48, 90 - 48), (20, 2))
    known = np.zeros((80, 90), np.bool_)
    known[3:51:2, 5:53:2].flat[random.permutation(576)[:count]] = True
    rows, columns = np.nonzero(known)
    shown, texels = seen[known], (rows - 3) * 90 + columns - 5
    difference, variance = plain.discontinuity(donor, shown, texels, blocks @ [90, 1], 4.0)
    expected = difference / (variance + shown.var(axis=0).sum() + 1.5)
    assert np.array_equal(_discontinuity((3, 5), blocks, donor, seen, known), expected)


def test_candidates_are_among_the_most_similar_places():
    found = project(features(), choose_basis(features(), 1))[::2, ::2]
    similar = find_candidates(found, 4, (slice(2, 70), slice(2, 86)))
    rows, columns = np.mgrid[0 : found.shape[0], 0 : found.shape[1]]
    away = np.maximum(np.abs(similar.rows - rows), np.abs(similar.columns - columns))
    assert away.min() >= 4
    flat = found[2:70, 2:86].reshape(-1, 8).astype(float)
    some = np.random.default_rng(1).integers(0, rows.size, 60)
    ratios = []
    for row, column in zip(rows.ravel()[some], columns.ravel()[some], strict=True):
        distance = ((flat - found[row, column]) ** 2).sum(1).reshape(68, 84)
        distance[max(row - 5, 0) : max(row + 2, 0), max(column - 5, 0) : max(column + 2, 0)] = 1e18
        own = found[similar.rows[row, column], similar.columns[row, column]].astype(float)
        ratios.append(((own - found[row, column]) ** 2).sum() / max(distance.min(), 1.0))
    assert np.median(ratios) < 3.5


def test_missing_compiled_loops_are_one_sentence(monkeypatch):
    monkeypatch.setattr("matcap.example.library.built", lambda: None)
    with pytest.raises(MatcapError, match="C compiler"):
        Example.of(blobs())


@pytest.mark.parametrize(("periods", "kept"), [(3.1, True), (2.5, False)])
def test_checks_as_large_as_a_third_of_an_exemplar_are_kept(periods, kept):
    height, width = 192, 256
    period = height / periods
    y, x = np.mgrid[:height, :width]
    waves = ((1.0 / period, 0.0), (0.0, 1.0 / period))
    checks = np.cos(2 * np.pi * x / period) + np.cos(2 * np.pi * y / period)
    planes = np.stack([checks, 0.5 * checks, *[np.zeros_like(checks)] * 5])
    lattice = measure_lattice(planes, waves)
    assert (lattice is not None) == kept
    if lattice is not None:
        # Neither bent nor drawn out by more than a few hundredths of a turn.
        found = lattice.phases(np.array([[16, 240]]), np.array([[16], [176]])) / 65536.0
        turns = np.diff(found[..., 0], axis=1) - np.diff(found[0, :, 0])
        assert np.abs(turns).max() < 0.05
        across = np.diff(found[0, :, 0])[0] - 224.0 / period
        assert abs(across - round(across)) < 0.05


def test_waves_by_which_an_exemplar_does_not_repeat_are_no_lattice():
    random = np.random.default_rng(2)
    rows = np.mgrid[:192, :256][0]
    across, along = (1.0 / 31.0, 0.0), (0.0, 1.0 / 24.0)
    stripes = np.cos(2 * np.pi * rows / 24.0) + 0.5 * random.standard_normal(rows.shape)
    boards = np.broadcast_to(random.standard_normal(8).repeat(32), rows.shape)
    for plane, wave, repeats in ((stripes, along, True), (boards, across, False)):
        planes = np.stack([plane, *[np.zeros_like(plane)] * 6])
        assert (measure_lattice(planes, (wave,)) is not None) == repeats


@pytest.mark.parametrize("aslant", [(0, 1), (1, 1), (1, -1), (-2, 1)])
def test_patches_of_tiles_end_at_joints_whichever_waves_were_found(aslant):
    """Waves along x, and along x and y, are of the same tiles; patches were cut aslant by them."""
    period = 22.0
    random = np.random.default_rng(3)
    y, x = np.mgrid[:192, :256]
    tiles = random.standard_normal((10, 13))[(y // period).astype(int), (x // period).astype(int)]
    joints = np.minimum(x % period, y % period) < 3.0
    planes = np.stack([np.where(joints, 2.0, tiles), *[np.zeros(tiles.shape)] * 6])
    planes -= planes.mean(axis=(1, 2), keepdims=True)
    waves = ((1.0 / period, 0.0), (aslant[0] / period, aslant[1] / period))
    lattice = measure_lattice(planes, waves)
    assert lattice is not None
    lattice = with_least_borders(planes, lattice)
    assert np.abs(lattice.waves).max(axis=0) == pytest.approx([1.0 / period] * 2, rel=0.02)
    assert np.abs(lattice.waves).min(axis=0) == pytest.approx([0.0, 0.0], abs=1e-3)
    borders = (np.abs(lattice.phases(x, y).astype(int)) < 1200).any(axis=-1)
    assert joints[borders].mean() > 0.8  # a phase is known to 1 / 24 turn


def test_patches_of_stripes_are_twice_as_long_as_wide():
    stripes = PhasedLattice(((1.0 / 20.0, 0.0),), np.zeros((1, 40, 40), np.int32))
    along = np.arange(0, 1920)
    cells = cells_of(stripes, 3, along, along, (None, None), 96.0)
    assert len(np.unique(cells.column)) in (20, 21)  # 5 stripes of 20 texels
    assert len(np.unique(cells.row)) in (10, 11)
    assert stripes.patch_extent(96.0) == pytest.approx((120.0, 192.0))


def test_phases_are_unwrapped_around_places_where_they_are_noise():
    """Line by line, every line through such a place would be off by a turn beyond it."""
    y, x = np.mgrid[:24, :32] / 16.0
    smooth = 1.5 * np.sin(x) + y
    noise = (np.hypot(x - 1.0, y - 0.6) < 0.25) * np.random.default_rng(4).uniform(
        -0.5, 0.5, x.shape
    )
    off = _unwrapped((smooth + noise) % 1.0) - smooth
    assert np.abs(off[noise == 0.0] - np.median(off)).max() < 1e-6


# How far a field takes its piece apart: from the piece repeated to many small ones.


def joined(example, side=384):
    """The share of texels that continue their left neighbour in the exemplar."""
    places = example.places(9, Rectangle(0, 0, side, side), None).astype(int)
    return float((np.diff(places, axis=1) == [1, 0]).all(-1).mean())


@pytest.mark.parametrize("example", [an_example, ordered], indirect=True)
def test_less_variety_has_larger_patches(example):
    shares = [joined(example.varied(variety)) for variety in (0.0, 0.3, 1.0)]
    assert shares[0] > shares[1] > shares[2] and shares[0] > 0.97


def test_patches_shrink_from_the_whole_frame_to_the_least_size():
    lookup = an_example().lookup
    level = lookup.levels[-1]
    sizes = [PatchSizes.of(level.frame, level.spacing, None, one / 8) for one in range(9)]
    for larger, smaller in zip(sizes, sizes[1:], strict=False):
        assert larger.width >= smaller.width and larger.height >= smaller.height
    assert sizes[0].width > 0.5 * (level.frame.right - level.frame.left)
    assert sizes[-1].loose and not sizes[-2].loose and lookup.sizes == sizes[-1]


def test_large_patches_show_all_of_the_exemplar_equally_often():
    example = large_blobs().varied(0.3)
    frame = example.lookup.joined
    x, y = example.places(2, Rectangle(0, 0, 2048, 2048), None)[::4, ::4].reshape(-1, 2).T
    sides = (np.linspace(frame.left, frame.right, 5), np.linspace(frame.top, frame.bottom, 5))
    shown = np.histogram2d(x, y, bins=sides)[0]
    assert shown.min() > 0.5 * shown.mean() and shown.max() < 1.5 * shown.mean()


@pytest.mark.parametrize(
    "example", [large_blobs, partial(ordered, 512, 384)], ids=["blobs", "bricks"], indirect=True
)
def test_the_least_variety_repeats_the_exemplar(example):
    example = example.varied(0.0)
    frame = example.lookup.joined
    wide, high = frame.right - frame.left + 1, frame.bottom - frame.top + 1
    one, other = (example.places(2, Rectangle(x, 300, 256, 256), None) for x in (50, 50 + wide))
    above = example.places(2, Rectangle(50, 300 - high, 256, 256), None)
    # Blocks begin elsewhere in the second copy, so that corrections may differ.
    assert (one == other).all(-1).mean() > 0.95 and (one == above).all(-1).mean() > 0.95


@pytest.mark.parametrize("variety", [0.0, 0.5])
@pytest.mark.parametrize("period", [(80, 48), (416, 304), (None, 304)])
def test_large_patches_repeat_exactly_too(variety, period):
    maps = an_example().varied(variety).maps(3, Rectangle(-33, 7, 500, 350), period)
    columns, rows = period
    if columns:
        assert np.array_equal(maps[:, :, :-columns], maps[:, :, columns:])
    assert np.array_equal(maps[:, :-rows], maps[:, rows:])


def test_a_variety_is_stored_and_full_variety_is_as_before_there_was_one():
    tensors, about = an_example().varied(0.25).stored()
    again = Example.read(about, tensors.__getitem__)
    assert again.variety == 0.25
    area = Rectangle(0, 0, 64, 64)
    assert np.array_equal(again.maps(1, area, None), an_example().varied(0.25).maps(1, area, None))
    assert "variety" not in an_example().stored()[1]
    del about["variety"]
    assert Example.read(about, tensors.__getitem__).variety == 1.0
    with pytest.raises(ValueError, match="variety"):
        Example.read(about | {"variety": 1.5}, tensors.__getitem__)


def test_a_material_is_read_with_another_variety():
    example = an_example()
    material = Material("blobs", {"example": example}, example.exemplar.texel_size, FlashSetup())
    one = material.varied(0.0).maps(96, 64, seed=2)
    assert not torch.equal(one.stacked(), material.maps(96, 64, seed=2).stacked())
    assert torch.equal(one.stacked(), material.varied(0.0).maps(96, 64, seed=2).stacked())
    assert material.varied(None) is material
    with pytest.raises(UsageError, match="variety of 2"):
        material.varied(2.0)


def test_every_command_that_reads_a_material_takes_a_variety(tmp_path, capsys):
    a_material("blobs", example=an_example()).save(tmp_path / "blobs.matcap")
    file, small = str(tmp_path / "blobs.matcap"), ["--size", "64x48", "-q"]
    for name, variety in (("own", []), ("one", ["--variety", "1"]), ("less", ["--variety", "0"])):
        assert main(["synth", file, *small, *variety, "-o", str(tmp_path / name)]) == 0
    own, one, less = (read_mapset(tmp_path / name) for name in ("own", "one", "less"))
    assert torch.equal(own[0].stacked(), one[0].stacked())
    assert not torch.equal(own[0].stacked(), less[0].stacked())
    assert less[1]["provenance"]["variety"] == 0.0 and "variety" not in own[1]["provenance"]
    asked = ["--variety", "0"]
    textures, picture, page = (str(tmp_path / name) for name in ("textures", "a.png", "a.html"))
    assert main(["export", file, *small, "--to", "gltf-textures", *asked, "-o", textures]) == 0
    assert main(["relight", file, *small, *asked, "-o", picture]) == 0
    assert main(["view", file, "-q", "--tile", "64", *asked, "--html", page]) == 0
    capsys.readouterr()
    assert main(["relight", str(tmp_path / "own"), *asked, "-o", str(tmp_path / "b.png")]) == 2
    assert "where this is fixed" in capsys.readouterr().err
    assert main(["synth", file, "--variety", "1.5"]) == 2
    a_material("plain", seed=5).save(tmp_path / "plain.matcap")
    assert main(["synth", str(tmp_path / "plain.matcap"), *asked]) == 2
    assert "no patches" in capsys.readouterr().err


@pytest.mark.parametrize(
    "example",
    [partial(varied, ordered, 0.3), lambda: ordered(480, 320, (24.0, 24.0), 0.5).varied(0.1)],
    ids=["nearly-straight", "bent"],
    indirect=True,
)
def test_a_lattice_keeps_its_phase_in_large_patches(example):
    lattice = example.index.lattice
    for x, y in ((0, 0), (16384, -16384), (2**40 - 128, 2**39)):
        places = example.places(3, Rectangle(x, y, 192, 192), None).astype(np.int64)
        columns, rows = np.arange(x, x + 192)[None, :], np.arange(y, y + 192)[:, None]
        apart = lattice.phases(places[..., 0], places[..., 1]) - lattice.ideal_phases(
            3, columns, rows, (None, None)
        )
        turns = apart.astype(float) / 2**16
        assert abs(turns.mean()) < 0.03 and np.sqrt((turns**2).mean()) < 0.06


@pytest.mark.parametrize(
    "bend, spread, bent", [(0.5, 0.0, True), (0.0, 0.0, False), (0.5, 0.3, False)]
)
def test_jumps_of_the_phase_are_not_taken_for_bending(bend, spread, bent):
    lattice = ordered(480, 320, (24.0, 24.0), bend).index.lattice
    jumps = np.random.default_rng(0).standard_normal(lattice.phase_offsets.shape) * spread
    moved = lattice.phase_offsets + np.rint(2**16 * (jumps + np.rint(9 * jumps))).astype(np.int32)
    assert replace(lattice, phase_offsets=moved).is_bent == bent


@cache
def stripes(width=512, height=384):
    """Boards as long as the photograph, each of its own colour, some 25 texels wide."""
    random = np.random.default_rng(4)
    edges = np.cumsum(random.integers(14, 40, 40))
    board = np.searchsorted(edges, np.arange(height))[:, None] + np.zeros((1, width), int)
    colour = random.standard_normal(60)[board]
    grain = 0.1 * random.standard_normal((4, height, width))
    return exemplar(np.stack([colour, colour, 0.3 * colour, np.zeros_like(colour)]) + grain)


@cache
def boards():
    return Example.of(stripes())


def plaid():
    """Bands of stripes() across and down, of cloth whose threads are a lattice of five texels."""
    bands = stripes().diffuse * stripes(384, 512).diffuse.swapaxes(1, 2)
    y, x = np.mgrid[0:384, 0:512] * 2.0 * np.pi / 5.0
    threads = 1.0 + 0.3 * np.cos(x) * np.cos(y)
    return replace(stripes(), diffuse=(bands * threads).clip(0.0, 1.0).astype(np.float32))


@pytest.mark.parametrize("waves", [(), ((0.2, 0.0), (0.0, 0.2))], ids=["plain", "lattice"])
def test_a_plaid_repeats_whole_and_boards_do_not(waves):
    assert with_chosen_variety(Example.of(plaid(), waves)).variety == 0.0 and not is_plaid(boards())


def test_a_slanted_plaid_repeats_where_its_bands_do_without_a_drift():
    """Bands of four tones every 200 and 152 texels, slanted by 2 %, brighter towards one corner."""
    y, x = np.mgrid[0:384, 0:512].astype(np.float32)
    tones = np.array([0.0, 0.5, 0.2, -0.6])

    def bands(at, repeat):
        return tones[(at % repeat // (repeat / 4)).astype(int)]

    log = bands(x + 0.02 * y, 200.0) + bands(y - 0.02 * x, 152.0) - 1.5
    log += 0.05 * np.random.default_rng(2).standard_normal(log.shape)
    drifting = log + 0.3 * x / 512 - 0.2 * y / 384
    diffuse = np.exp(drifting)[None].repeat(3, axis=0).clip(0.0, 1.0).astype(np.float32)
    example = with_chosen_variety(Example.of(replace(stripes(), diffuse=diffuse)))
    wide, high = example.lookup.joined.size
    for side, repeat in ((wide, 200), (high, 152)):
        assert abs(side - round(side / repeat) * repeat) <= 0.5 * example.alignment
    field = np.log(example.maps(0, Rectangle(0, 0, 2 * wide, 2 * high), None)[0])
    assert np.abs(field[:high] - field[high:]).max() < 0.05
    assert np.abs(field[:, :wide] - field[:, wide:]).max() < 0.05
    for axis in (0, 1):
        lines = field.mean(axis=axis)
        off = np.abs(lines[:, None] - lines.mean() - (tones - tones.mean())).min(axis=1)
        assert np.quantile(off, 0.9) < 0.06  # of 0.2 and more between tones, the drift's 0.3


@pytest.mark.parametrize("size", [(96, 80), (704, 512), (1760, 1296), (3680, 2720)])
def test_a_plaid_of_any_size_is_continued_so_that_its_frame_is_the_repeat(size):
    before, after = _margins(*size)
    whole = tuple(side + before + after for side in size)
    bits = halvings(max(whole))
    width, height = (side >> bits for side in whole)
    depth = level_count(width, height) - 1
    # A line more than the repeat, whose first it is compared with.
    more = 1 << grid_bits(depth)
    frame = frame_of(depth, Frame.of(width, height)).size
    assert frame == tuple((side >> bits) + more for side in size)


def test_a_cloth_of_uneven_threads_is_no_plaid():
    draws = np.random.default_rng(3)
    across, down = (1.0 + 0.3 * draws.standard_normal(n).repeat(8) for n in (64, 48))
    threads = np.sqrt(down[:, None] * across).clip(0.1, 2.0)
    diffuse = (0.4 * np.broadcast_to(threads, (3, 384, 512))).clip(0.0, 1.0)
    assert not is_plaid(Example.of(replace(stripes(), diffuse=diffuse.astype(np.float32))))


def test_a_lattice_of_large_cells_is_no_plaid():
    assert not is_plaid(Example.of(plaid(), ((1 / 40, 0.0), (0.0, 1 / 40))))


def test_only_long_structures_get_large_patches():
    assert with_chosen_variety(large_blobs()).variety == 1.0
    long, tries = variety_trials(boards())
    first, *_, last = tries
    assert long > 0.1 and last.lost < 0.8 * first.lost
    assert with_chosen_variety(boards()).variety < 1.0


def kept_along_x(albedo):
    """Correlation of log albedo with itself 96 texels on."""
    log = np.log(albedo)
    log -= log.mean()
    return (log[:, 96:] * log[:, :-96]).mean() / np.square(log).mean()


@pytest.mark.parametrize("turned", [False, True])
def test_patches_are_longer_along_the_grain_so_that_streaks_are(turned):
    piece = grained()
    made = Example.of(piece.turned() if turned else piece)
    assert made.index.aspect == (0.25 if turned else 4.0)
    square = replace(made, index=replace(made.index, aspect=1.0))
    kept = []
    for one in (made, square):
        albedos = (one.maps(seed, Rectangle(0, 0, 768, 768), None)[0] for seed in range(3))
        kept.append(np.mean([kept_along_x(each.T if turned else each) for each in albedos]))
    assert kept[0] > 1.4 * kept[1]


def test_an_aspect_is_stored_and_a_file_without_one_keeps_square_patches():
    tensors, about = Example.of(grained()).stored()
    again = Example.read(about, tensors.__getitem__)
    assert again.index.aspect == 4.0 and again.lookup.sizes.width == 4 * again.lookup.sizes.height
    with pytest.raises(ValueError, match="aspect"):
        Example.read(about | {"index": about["index"] | {"aspect": 9.0}}, tensors.__getitem__)
    del about["index"]["aspect"]
    sizes = Example.read(about, tensors.__getitem__).lookup.sizes
    assert sizes.aspect == 1.0 and sizes.width == sizes.height
    assert "aspect" not in an_example().stored()[1]["index"]


def test_fitted_patches_get_no_narrower_than_what_recurs_in_sight():
    frame = frame_of(4, Frame.of(1024, 768))
    for variety in (0.5, 0.25):
        for aspect in (4.0, 0.25):
            square, long = (PatchSizes.of(frame, 16, None, variety, one) for one in (1.0, aspect))
            shorter, longer = sorted((long.width, long.height))
            assert 256 <= shorter < min(square.width, square.height) and longer > shorter
            assert (long.width > square.width) == (aspect > 1.0)


def test_the_summary_states_the_patch_size():
    whole, small = summary(an_example().varied(0.0)), summary(an_example())
    assert whole.patches[0] > small.patches[0] and "% of the photograph" in whole.patches_text()
    # Texels of 2 / 1024 units of a metre.
    length = whole.patches[0] * 2 / 1024 * 100
    assert whole.patches_text(1000.0) == f"patches of about {length:.2g} cm"
    assert ("variety", f"0: {whole.patches_text()}.") in whole.lines()


# Exemplars with a fine lattice are straightened and get one cell, others are left alone.

WAVES = ((0.16, 0.02), (-0.03, 0.18))
WIDTH, HEIGHT = 512, 384


@cache
def woven(bend=0.0, contrast=0.0, noise=0.0):
    """An exemplar with a weave of some six texels, displaced by `bend` texels, at most twice.

    One of its waves is weaker by `contrast` in the middle, the other at the borders.
    """
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    at_x = x + bend * np.sin(2.2 * np.pi * y / HEIGHT) * np.cos(1.5 * np.pi * x / WIDTH)
    at_y = y + bend * np.cos(1.3 * np.pi * (x + y) / WIDTH)
    drawing = sum(
        (1.0 + changing * np.cos(2 * np.pi * x / WIDTH))
        * np.cos(2 * np.pi * (fx * at_x + fy * at_y))
        for changing, (fx, fy) in zip((contrast, -contrast), WAVES, strict=True)
    )
    drawing = drawing + noise * np.random.default_rng(1).standard_normal(drawing.shape)
    flat = np.ones((1, HEIGHT, WIDTH), np.float32)
    albedo = (0.3 * np.exp(0.2 * drawing)).clip(0.0, 1.0).astype(np.float32)
    stacked = np.concatenate(
        [albedo[None].repeat(3, 0), 0.04 * flat, 0.6 * flat, 0.001 * drawing[None]]
    )
    return Exemplar.certain(stacked.astype(np.float32), 2.0 / WIDTH).rounded()


def demodulated(exemplar, waves):
    """(waves, rows, columns) log albedo demodulated in squares of 32 texels."""
    log = np.log(exemplar.diffuse[1].astype(np.float64))
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    turned = [(log - log.mean()) * np.exp(-2j * np.pi * (fx * x + fy * y)) for fx, fy in waves]
    squares = np.reshape(turned, (len(waves), HEIGHT // 32, 32, WIDTH // 32, 32))
    return squares.mean(axis=(2, 4))[:, 1:-1, 1:-1]


def coherence(exemplar, waves):
    """Of each wave, |mean| over mean | |."""
    local = demodulated(exemplar, waves)
    return np.abs(local.mean(axis=(1, 2))) / np.abs(local).mean(axis=(1, 2))


def unevenness(exemplar, waves):
    """Of each wave, the largest over the least amplitude from left to right."""
    columns = np.abs(demodulated(exemplar, waves)).mean(axis=1)
    return columns.max(axis=1) / columns.min(axis=1)


@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_a_bent_weave_becomes_straight_and_even(noise):
    bent = woven(bend=12.0, contrast=0.4, noise=noise)
    assert max(coherence(bent, WAVES)) < 0.6
    found = straightened(bent, WAVES)
    assert found is not None
    flat, waves = found
    assert min(coherence(flat, waves)) > 0.97
    assert min(unevenness(woven(contrast=0.4, noise=noise), WAVES)) > 1.8
    assert max(unevenness(flat, waves)) < 1.2
    # Texels that lie beyond the exemplar are not known.
    assert 0.9 < (flat.confidence > 0).mean() < 1.0


def test_the_shortest_waves_of_a_lattice_are_followed():
    (ax, ay), (bx, by) = WAVES
    flat, waves = straightened(woven(bend=12.0), ((ax, ay), (bx - 2 * ax, by - 2 * ay)))
    assert np.allclose(np.abs(waves), np.abs(WAVES), atol=0.01)


def test_a_weave_that_softens_to_one_side_has_smaller_patches_than_an_even_one():
    even = woven(noise=0.5)
    soft = np.stack([cv2.GaussianBlur(plane, (0, 0), 2.0) for plane in even.stacked()])
    share = np.linspace(0.0, 1.0, WIDTH, dtype=np.float32)
    mixed = Exemplar.certain((1.0 - share) * even.stacked() + share * soft, even.texel_size)
    for one, least, most in ((even, 0.1, 0.1), (mixed, 0.5, 1.0)):
        example = Example.of_rounded(one.rounded(), WAVES, straight=True)
        assert least <= with_least_steps(example).variety <= most


@pytest.mark.parametrize(
    ("form", "waves"),
    [
        ({"bend": 0.5}, WAVES),  # straight
        ({"bend": 12.0}, WAVES[:1]),  # stripes
        ({"bend": 12.0, "noise": 20.0}, WAVES),  # lost in noise
        ({"bend": 12.0}, ((0.05, 0.0), (0.0, 0.05))),  # coarse: lattice.py follows its bend
        ({"bend": 12.0}, ()),
    ],
)
def test_exemplars_without_a_fine_lattice_are_not_straightened(form, waves):
    assert straightened(woven(**form), waves) is None


def test_a_capture_keeps_the_maps_beside_the_photograph():
    bent = woven(bend=12.0)
    kept, example = indexed(bent, WAVES, turned=False)
    assert kept is bent and min(coherence(example.exemplar, example.index.lattice.waves)) > 0.97
    assert not example.index.lattice.phase_offsets.std(axis=(1, 2)).any()
