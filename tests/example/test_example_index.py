"""The index survives its file, and the compiled loops are the plain ones."""

import numpy as np
import plain_loops as plain
import pytest
from exemplars import an_example, blobs, ordered, reread

from matcap.errors import MatcapError
from matcap.example.appearance import choose_basis, project
from matcap.example.candidates import find_candidates
from matcap.example.correction import correct
from matcap.example.example import Example
from matcap.example.features import choose_scale, features_of, planes_of
from matcap.example.lattice import PhasedLattice, _unwrapped, cells_of, measure_lattice
from matcap.example.lookup import prepare
from matcap.field.plane import Rectangle


def features():
    planes = planes_of(blobs())
    return features_of(planes, choose_scale(planes))


@pytest.mark.parametrize("example", [an_example(), ordered()], ids=["blobs", "bricks"])
def test_a_file_gives_back_the_same_field(example):
    again = reread(example)
    area = Rectangle(5, -9, 70, 50)
    assert np.array_equal(again.maps(3, area, None), example.maps(3, area, None))
    assert again.index.left_out == example.index.left_out


@pytest.mark.parametrize("size", [(114, 113), (97, 128)])
def test_a_file_is_read_again_whatever_the_sides_of_its_piece(size):
    """Grids of its levels are rounded down at each, which is less than by all at once."""
    piece = blobs(*size)
    example = Example.of(piece)
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
    from matcap.example.packed import pack

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


@pytest.mark.parametrize("example", [an_example(), ordered()], ids=["blobs", "bricks"])
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
        assert np.array_equal(found, expected)
        assert (found != places[16:-16, 16:-16]).any()


def test_similar_places_are_among_the_most_similar_there_are():
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


def test_without_compiled_loops_a_sentence_says_what_to_do(monkeypatch):
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
    turns = _unwrapped((smooth + noise) % 1.0)
    off = turns - smooth
    assert np.abs(off[noise == 0.0] - np.median(off)).max() < 1e-6
