"""Cameras, feature matches and covariances of registration."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from simulated.photographs import Hand, PhoneCamera, hold, relative_position

from matcap.capture.registration import camera as registration_camera
from matcap.capture.registration.camera import (
    Adjusted,
    Lens,
    Pair,
    PosedCamera,
    adjust,
    camera_deviations,
    grid_points,
)
from matcap.capture.registration.keypoints import Keypoints, find_keypoints, matched, mutual_nearest
from matcap.capture.registration.one_place import normalise_contrast
from matcap.capture.registration.register import MATCHES
from matcap.flash.geometry import FlashSetup, project
from matcap.photo.checks import CHECKS
from matcap.photo.photo import Photo

# Cameras over the plane, and bundle adjustment of them.


SETUP = FlashSetup(fov=65.0, tilt=(0.1, -0.05))
POINTS = grid_points(16, 12)
PHONE = PhoneCamera(width=800, height=600)


@pytest.mark.parametrize("bent", [(0.0, 0.0), (0.03, -0.01), (-0.03, 0.01)])
def test_projection_and_unprojection_are_inverse(bent):
    camera = PosedCamera.of(SETUP, bent)
    np.testing.assert_allclose(camera.on_plane(camera.sees(POINTS)), POINTS, atol=1e-9)


def test_the_camera_of_a_photograph_is_that_of_its_plane():
    camera = PosedCamera.of(SETUP)
    expected = project(torch.from_numpy(POINTS), SETUP)
    np.testing.assert_allclose(camera.sees(POINTS), expected, atol=1e-12)
    assert camera.tilt == pytest.approx(math.acos(math.cos(0.1) * math.cos(-0.05)))


def test_points_behind_the_camera_are_not_seen():
    camera = PosedCamera(np.diag([1.0, 1.0, 1.0]), np.array([0.0, 0.0, -1.0]), Lens(1.5))
    assert np.isnan(camera.sees(POINTS)).all()


def _pairs(cameras, noise=0.0):
    rng = np.random.default_rng(1)
    first, *others = (camera.sees(POINTS.reshape(3, -1)) for camera in cameras)
    noisy = [other + noise * rng.normal(size=other.shape) for other in others]
    return _matches([first, *noisy], 1.0 / 800.0)


def _matches(images, pixel):
    """Of each picture's points those that it and the first one show."""
    shown = [np.abs(image).max(0) < 1.0 for image in images]
    pairs = zip(images[1:], shown[1:], strict=True)
    return [Pair(images[0][:, shown[0] & by], one[:, shown[0] & by], pixel) for one, by in pairs]


def test_exact_matches_give_the_cameras_back(monkeypatch):
    cameras = hold(PHONE, Hand(bent=(0.02, -0.005)), 5, 2)
    monkeypatch.setattr(registration_camera, "_COUNTED", 1e6)
    found = adjust(FlashSetup(fov=PHONE.fov), _pairs(cameras), known=True, relief=0.0)
    assert found.first.fov == pytest.approx(PHONE.fov, abs=0.05)
    distance = float(np.linalg.norm(cameras[0].place))
    for camera, true in zip(found.cameras, cameras, strict=True):
        assert np.linalg.norm(camera.place - true.place) < 0.002 * distance
    assert max(found.reprojection_errors) < 0.05


def test_matches_off_by_half_a_pixel_cost_half_a_percent():
    cameras = hold(PHONE, Hand(), 5, 3)
    found = adjust(FlashSetup(fov=PHONE.fov), _pairs(cameras, 0.5 / 400.0), known=True)
    for camera, true in zip(found.cameras[1:], cameras[1:], strict=True):
        off = relative_position(found.cameras[0], camera) - relative_position(cameras[0], true)
        assert np.linalg.norm(off) < 0.02 * np.linalg.norm(true.place)


def test_a_wrong_start_is_corrected():
    cameras = hold(PHONE, Hand(), 4, 4)
    leaning = replace(FlashSetup(fov=PHONE.fov), tilt=(0.08, -0.06))
    found = adjust(leaning, _pairs(cameras), known=True)
    true = PosedCamera.of(FlashSetup(fov=PHONE.fov, tilt=found.first.tilt))
    assert np.abs(true.turn - cameras[0].turn).max() < 0.01


# Positions of features, and their matches.


def _grain():
    smooth = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(180, 240)), (0, 0), 2.0)
    pixels = np.exp(0.3 * smooth / smooth.std()).astype(np.float32)[..., None].repeat(3, 2) / 4.0
    return Photo(pixels, pixels.max(-1) >= 1.0, 65.0, "exif", False, "grain", (240, 180))


def test_features_are_invariant_to_rotation():
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


def test_one_right_match_in_thirty_suffices():
    for seed in range(3):
        first, second = _mistaken(30, 870, seed)
        found, _ = matched(first, second)
        right = {tuple(place) for place in first.image[:, :30].T}
        kept = {tuple(place) for place in found.T}
        assert len(kept & right) >= 28 and len(kept - right) <= 2


def test_chance_agreement_is_refused():
    for seed in range(3):
        found, _ = matched(*_mistaken(0, 900, seed))
        assert found.shape[1] < MATCHES - 4


@pytest.mark.parametrize("ratio", [0.8, 0.95])
def test_features_are_matched_that_are_nearest_both_ways(ratio):
    """As by OpenCV's matcher; more of them than one block of distances has."""
    rng = np.random.default_rng(0)
    first = rng.random((2100, 128), np.float32)
    others = rng.permutation(2100)[:1500]
    second = np.concatenate([first[others], rng.random((400, 128), np.float32)])
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


# Standard deviations of cameras and of registration are as large as the true errors.


PIXEL = 1.0 / 400.0
(UNCERTAIN,) = CHECKS["cameras"].limits


def _adjusted(seed, noise, depths, count=800):
    """True cameras, matches, and the cameras fitted to them.

    Matches are off by `noise` pixels, and by the shading of features of apparent `depths`.
    """
    rng = np.random.default_rng(seed)
    cameras = hold(PHONE, Hand(), 5, seed)
    points = np.stack([rng.uniform(-1.0, 1.0, count), rng.uniform(-0.75, 0.75, count)])
    deep = depths(rng, count)

    def seen(camera):
        towards = (camera.place[:2, None] - points) / camera.place[2]
        moved = deep * towards / (1.0 + np.square(towards).sum(0) / 0.5**2)
        image = camera.sees(np.stack([*(points + moved), np.zeros(count)]))
        return image + noise * PIXEL * rng.normal(size=image.shape)

    pairs = _matches([seen(camera) for camera in cameras], PIXEL)
    return cameras, pairs, adjust(FlashSetup(fov=PHONE.fov), pairs, known=True)


def _position_errors(true, found):
    """Errors of positions relative to the first camera, over their distance."""
    places, wanted = (
        np.array([relative_position(cameras[0], camera) for camera in cameras[1:]])
        for cameras in (found.cameras, true)
    )
    distances = np.linalg.norm([camera.place for camera in true[1:]], axis=1)
    return np.linalg.norm(places - wanted, axis=1) / distances


def _misregistration(true, found):
    """Plane units by which photographs are off the first, where both show the plane."""
    points = np.stack([*np.random.default_rng(0).uniform(-0.7, 0.7, (2, 500)), np.zeros(500)])
    image = found.cameras[0].sees(points)
    off = []
    for camera, other in zip(found.cameras[1:], true[1:], strict=True):
        there = other.sees(true[0].on_plane(image))
        apart = camera.on_plane(there) - points
        off.append(np.sqrt(np.square(apart[:, np.abs(there).max(0) < 1.0]).sum(0).mean()))
    return np.array(off)


def _flat(rng, count):
    return np.zeros(count)


def _bumps(rng, count):
    """Alike, as leather's cells: their mean depth is twice its standard deviation."""
    return rng.normal(0.014, 0.007, count)


def test_deviations_of_a_flat_sample_are_small():
    _, pairs, found = _adjusted(1, 0.1, _flat)
    deviations = camera_deviations(found, pairs)
    assert deviations.positions.max() < UNCERTAIN
    _, pairs, found = _adjusted(1, 0.4, _bumps)
    relief = camera_deviations(found, pairs)
    assert (deviations.misregistration < 0.25 * relief.misregistration).all()


@pytest.mark.parametrize("seed", range(3))
def test_deviations_cover_errors_by_shading(seed):
    true, pairs, found = _adjusted(seed, 0.4, _bumps)
    deviations = camera_deviations(found, pairs)
    off = _position_errors(true, found)
    assert off.max() > UNCERTAIN  # else this shows nothing
    assert (deviations.positions[off > UNCERTAIN] > UNCERTAIN).all()
    # Neither too small nor too large.
    assert 0.3 < np.sqrt(np.mean((off / deviations.positions) ** 2)) < 2.0
    off = _misregistration(true, found)
    assert 0.3 < np.sqrt(np.mean((off / deviations.misregistration) ** 2)) < 2.0


@pytest.mark.parametrize("more", [1.0, 2.0])
def test_deeper_relief_is_less_certain(more, monkeypatch):
    _, pairs, found = _adjusted(2, 0.4, lambda rng, count: more * _bumps(rng, count))
    both = camera_deviations(found, pairs).positions
    monkeypatch.setattr(registration_camera, "_COMMON_DEPTH", 0.0)
    assert (both > 1.5 * camera_deviations(found, pairs).positions).all()


def test_fewer_matches_are_less_certain(monkeypatch):
    _, pairs, found = _adjusted(3, 0.5, _flat)
    few = [Pair(p.first[:, ::8], p.second[:, ::8], p.pixel) for p in pairs]
    monkeypatch.setattr(registration_camera, "_COMMON_DEPTH", 0.0)
    by_few, by_all = (camera_deviations(found, some).positions for some in (few, pairs))
    assert (by_few > 1.5 * by_all).all()


def test_without_matches_there_is_no_deviation():
    found = adjust(FlashSetup(fov=PHONE.fov), [], known=True)
    assert isinstance(found, Adjusted) and camera_deviations(found, []).positions.shape == (0,)
    assert camera_deviations(found, []).misregistration.shape == (0,)
