"""Positions of features, and their matches."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from matcap.capture.registration.keypoints import (
    Keypoints,
    find_keypoints,
    matched,
    mutual_nearest,
    normalise_contrast,
)
from matcap.capture.registration.register import MATCHES
from matcap.photo.photo import Photo


def _grain():
    noise = np.random.default_rng(0).normal(size=(180, 240))
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    pixels = np.exp(0.3 * smooth / smooth.std()).astype(np.float32)[..., None].repeat(3, 2) / 4.0
    return Photo(pixels, pixels.max(-1) >= 1.0, 65.0, "exif", False, "grain", (240, 180))


def test_features_lie_where_they_are_whichever_way_the_picture_is_held():
    photo = _grain()
    turned = replace(photo, pixels=np.ascontiguousarray(photo.pixels[::-1, ::-1]))
    one, other = (find_keypoints(each, normalise_contrast) for each in (photo, turned))
    pairs = cv2.BFMatcher(crossCheck=True).match(one.described, other.described)
    first = one.image[:, [pair.queryIdx for pair in pairs]]
    second = -other.image[:, [pair.trainIdx for pair in pairs]]
    off = np.median(first - second, 1) / 2.0 / one.pixel
    np.testing.assert_allclose(off, 0.0, atol=0.02)


def _mistaken(right, wrong, seed):
    """Keypoints of two views of a plane with equal descriptors, of which `right` match."""
    rng = np.random.default_rng(seed)
    count = right + wrong
    one = rng.uniform((-1.0, -0.75), (1.0, 0.75), (count, 2)).T
    turn = 0.9 * np.exp(0.2j)
    there = turn * (one[0] + 1j * one[1]) + 0.05 - 0.1j
    there = there / (1.0 + 0.15 * one[0])  # it leans
    elsewhere = rng.uniform((-1.0, -0.75), (1.0, 0.75), (wrong, 2))
    there[right:] = elsewhere[:, 0] + 1j * elsewhere[:, 1]
    shapes = turn * np.exp(0.1 * (rng.normal(size=count) + 1j * rng.normal(size=count)))
    shapes[right:] = np.exp(0.5 * rng.normal(size=wrong) + 2j * np.pi * rng.random(wrong))
    described = rng.random((count, 128), np.float32)
    first = Keypoints(one, described, 1.0 / 400.0, np.full(count, 0.01 + 0j))
    second = Keypoints(np.stack([there.real, there.imag]), described, 1.0 / 400.0, 0.01 * shapes)
    return first, second


def test_one_match_in_thirty_that_is_right_is_found():
    for seed in range(3):
        first, second = _mistaken(30, 870, seed)
        found, _ = matched(first, second)
        right = {tuple(place) for place in first.image[:, :30].T}
        kept = {tuple(place) for place in found.T}
        assert len(kept & right) >= 28 and len(kept - right) <= 2


def test_what_agrees_by_chance_is_too_little():
    for seed in range(3):
        found, _ = matched(*_mistaken(0, 900, seed))
        assert found.shape[1] < MATCHES - 4


@pytest.mark.parametrize("ratio", [0.8, 0.95])
def test_features_are_matched_that_are_nearest_both_ways(ratio):
    """As by OpenCV's matcher; more of them than one block of distances has."""
    rng = np.random.default_rng(0)
    first = rng.random((2100, 128), np.float32)
    second = np.concatenate(
        [first[rng.permutation(2100)[:1500]], rng.random((400, 128), np.float32)]
    )
    second += 0.25 * rng.normal(size=second.shape).astype(np.float32)
    forth = cv2.BFMatcher().knnMatch(first, second, k=2)
    back = {m.queryIdx: m.trainIdx for m in cv2.BFMatcher().match(second, first)}
    plain = [
        (a.queryIdx, a.trainIdx)
        for a, b in forth
        if a.distance < ratio * b.distance and back[a.trainIdx] == a.queryIdx
    ]
    assert 500 < len(plain) < 1800
    assert list(zip(*mutual_nearest(first, second, ratio), strict=True)) == plain
