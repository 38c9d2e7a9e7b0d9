"""Maps are the exemplar's where nothing was rearranged, and join where something was."""

from dataclasses import replace

import numpy as np
import plain_loops as plain
import pytest
from exemplars import a_coloured_example, an_example, blobs, exemplar, ordered

from matcap.example.blend import BAND_LEVELS, BANDS, ExemplarBands, Nodes, Votes, bands_of, blended
from matcap.example.example import Example
from matcap.field.plane import Rectangle

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


@pytest.mark.parametrize("example", [an_example, a_coloured_example, ordered])
@pytest.mark.parametrize("period", [None, (176, 144), (48, 80)])
def test_the_loop_is_the_plain_one_to_the_bit(example, period, monkeypatch):
    area = Rectangle(-37, 501, 90, 70)
    found = example().maps(3, area, period)
    monkeypatch.setattr("matcap.example.example.blended", plain.blended)
    assert np.array_equal(found, example().maps(3, area, period))


def test_detail_is_blended_as_it_is_plainly(monkeypatch):
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


def test_what_is_not_rearranged_is_the_exemplar_to_the_bit():
    found, plainly = halves(blobs(500, 300), (90, 80), (90, 80))
    assert np.array_equal(found, plainly)
    found, plainly = halves(blobs(500, 300), (90, 80), (150, 100))
    changed = (found != plainly).any(axis=(0, 1))
    far = 3 << (BANDS - 2)  # nodes reach one and a half steps of 2^(bands - 1) texels
    middle = SIZE[0] // 2
    assert changed[middle - 8 : middle + 8].all()
    assert not changed[: middle - far].any() and not changed[middle + far :].any()


def test_a_step_of_colour_and_height_becomes_a_slope():
    step = np.where(np.arange(800) < 400, -0.7, 0.7)[None].repeat(300, axis=0)
    piece = exemplar(np.stack([step] * 4))
    found, plainly = halves(piece, (90, 80), (400, 80))
    for index in (0, 3, 5):
        across = np.abs(np.diff(found[index][60])).max()
        assert across < 0.08 * np.abs(np.diff(plainly[index][60])).max()
        ends = found[index][60, [0, -1]]
        assert np.array_equal(ends, plainly[index][60, [0, -1]])


def test_contrast_is_kept_where_pieces_meet():
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


def test_parts_are_the_whole_where_pieces_are_small():
    example = replace(an_example(), variety=1.0)
    whole = example.maps(6, Rectangle(-90, -70, 300, 200), None)
    part = example.maps(6, Rectangle(-11, 13, 71, 40), None)
    assert np.array_equal(part, whole[:, 83:123, 79:150])
