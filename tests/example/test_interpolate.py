"""An exemplar between two: patterns on each other, statistics in between, ends as they are."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from exemplars import blobs, bricks, coloured

from matcap.example.exemplar import CHANNELS, DIFFUSE, HEIGHT, ROUGHNESS
from matcap.example.interpolate import interpolated, octaves, overlay, pattern_of, patterns_of

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)


def dark_bricks():
    """Bricks half as bright, a quarter rougher and three times as deep as the blobs."""
    exemplar = bricks()
    return replace(
        exemplar,
        diffuse=0.5 * exemplar.diffuse,
        roughness=1.25 * exemplar.roughness,
        height=3.0 * exemplar.height,
    )


@cache
def at(share):
    return interpolated(blobs(), dark_bricks(), share)


def deviations(exemplar, channels):
    return [
        np.mean([octave.std() for octave in layer])
        for layer in zip(*(octaves(plane) for plane in exemplar.stacked()[channels]), strict=True)
    ]


def test_the_ends_are_the_given_exemplars():
    first, second = blobs(), dark_bricks()
    assert interpolated(first, second, 0.0) is first and interpolated(first, second, 1.0) is second


@pytest.mark.parametrize(("share", "end"), [(0.02, blobs), (0.98, dark_bricks)])
def test_near_an_end_texels_are_nearly_those_of_that_end(share, end):
    near, own = at(share).stacked(), end().stacked()
    for plane, given in zip(near, own, strict=True):
        assert np.corrcoef(plane.ravel(), given.ravel())[0, 1] > 0.98
        assert abs(plane.std() / given.std() - 1.0) < 0.1


@pytest.mark.parametrize("channels", [DIFFUSE, ROUGHNESS])
def test_means_are_interpolated(channels):
    means = [float(at(share).stacked()[channels].mean()) for share in SHARES]
    assert means in (sorted(means), sorted(means, reverse=True))


def test_logarithms_of_the_octaves_deviations_go_evenly_from_one_to_the_other():
    heights = np.log([deviations(at(share), HEIGHT) for share in SHARES])
    assert np.abs(heights - np.linspace(heights[0], heights[-1], len(SHARES))).max() < 0.3


def test_values_have_the_interpolated_distribution():
    ends = [np.quantile(end().roughness, SHARES) for end in (blobs, dark_bricks)]
    found = np.quantile(at(0.5).roughness, SHARES)
    assert found == pytest.approx((ends[0] + ends[1]) / 2.0, abs=2e-3)


def test_patterns_are_registered_before_they_are_mixed():
    drawings = patterns_of(blobs(), dark_bricks())
    rows, columns = blobs().height.shape[1:]
    by_chance = np.corrcoef(drawings[0].ravel(), drawings[1][:rows, :columns].ravel())[0, 1]
    laid = overlay(blobs(), dark_bricks(), 0.5, (columns, rows))
    first, second = (
        drawing[places[..., 1], places[..., 0]]
        for drawing, places in zip(drawings, (laid.first, laid.second), strict=True)
    )
    assert abs(by_chance) < 0.2 and np.corrcoef(first.ravel(), second.ravel())[0, 1] > 0.6
    # Patches, not single texels: most neighbours show neighbours.
    for places in (laid.first, laid.second):
        assert (np.diff(places, axis=1) == (1, 0)).all(axis=-1).mean() > 0.5


def test_interpolation_is_deterministic():
    again = interpolated(blobs(), dark_bricks(), 0.5)
    assert np.array_equal(again.stacked(), at(0.5).stacked())
    assert not np.array_equal(again.stacked(), at(0.25).stacked()[:, :144, :176])


def test_a_crease_compares_with_a_dark_line():
    flat = np.full((64, 64), 0.5, np.float32)
    line = np.exp(-((np.arange(64) - 32.0) ** 2) / 8.0).astype(np.float32)[None, :]
    maps = {name: np.stack([flat] * count) for name, count in CHANNELS.items()}
    known = np.ones((4, 64, 64), np.float32)
    plain = replace(blobs(), **maps, confidence=known)
    painted = replace(plain, diffuse=maps["diffuse"] * (1.0 - 0.5 * line))
    creased = replace(plain, height=maps["height"] - 3.0 * plain.texel_size * line)
    for exemplar in (painted, creased):
        assert set(np.argmin(pattern_of(exemplar), axis=1)) == {32}


def test_texel_size_is_interpolated_as_a_logarithm_and_size_is_the_nearer_ones():
    finer = replace(bricks(400, 240), texel_size=blobs().texel_size / 2.0)
    near_first, near_second = interpolated(blobs(), finer, 0.25), interpolated(blobs(), finer, 0.75)
    assert near_first.texel_size == pytest.approx(blobs().texel_size * 0.5**0.25)
    assert near_first.size == (209, 171)  # 176 x 144 of the coarser, sqrt(sqrt(2)) as fine
    assert near_second.size == (336, 202)


def test_a_metal_and_a_dielectric_meet_half_way_and_reflect_no_more_than_they_receive():
    metal = replace(
        coloured(blobs()), diffuse=0.0 * blobs().diffuse, specular=8.0 * coloured(blobs()).specular
    )
    middle = interpolated(dark_bricks(), metal, 0.5)
    assert middle.coloured and float((middle.diffuse + middle.specular).max()) <= 1.0
    assert middle.diffuse.mean() == pytest.approx(dark_bricks().diffuse.mean() / 4.0, rel=0.1)
    ends = [np.sqrt(one.specular).mean() for one in (dark_bricks(), metal)]
    assert np.sqrt(middle.specular).mean() == pytest.approx(sum(ends) / 2.0, rel=0.05)


def test_what_either_photograph_does_not_show_stays_unknown():
    hidden = blobs().confidence.copy()
    hidden[:, :, :40] = 0.0
    middle = interpolated(replace(blobs(), confidence=hidden), dark_bricks(), 0.1)
    assert middle.confidence[:, :, :30].max() == 0.0 and middle.confidence[:, :, 60:].min() == 1.0


def test_exemplars_of_any_shape_are_interpolated():
    tall = bricks(40, 90)
    for first, second in ((tall, blobs(14, 20)), (blobs(14, 20), tall)):
        middle = interpolated(first, second, 0.5)
        assert middle.size == first.size and np.isfinite(middle.stacked()).all()


def test_exemplars_without_a_pattern_blend_to_their_means():
    means = {name: getattr(blobs(), name).mean(axis=(1, 2), keepdims=True) for name in CHANNELS}
    flat = replace(
        blobs(), **{name: mean.repeat(144, 1).repeat(176, 2) for name, mean in means.items()}
    )
    assert np.allclose(interpolated(flat, flat, 0.5).stacked(), flat.stacked(), atol=1e-4)
