"""Standard deviations of cameras and of registration are as large as the true errors."""

import numpy as np
import pytest
from simulated.photographs import Hand, PhoneCamera, hold, relative_position

from matcap.capture.registration import covariance
from matcap.capture.registration.adjust import Adjusted, Pair, adjust
from matcap.capture.registration.covariance import camera_deviations
from matcap.flash.geometry import FlashSetup
from matcap.photo.checks import CHECKS

PHONE = PhoneCamera(width=800, height=600)
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

    images = [seen(camera) for camera in cameras]
    pairs = []
    for image in images[1:]:
        both = (np.abs(images[0]).max(0) < 1.0) & (np.abs(image).max(0) < 1.0)
        pairs.append(Pair(images[0][:, both], image[:, both], PIXEL))
    return cameras, pairs, adjust(FlashSetup(fov=PHONE.fov), pairs, known=True)


def _position_errors(true, found):
    """Errors of positions relative to the first camera, over their distance."""

    first, *others = found.cameras
    return np.array(
        [
            np.linalg.norm(relative_position(first, camera) - relative_position(true[0], other))
            / np.linalg.norm(other.place)
            for camera, other in zip(others, true[1:], strict=True)
        ]
    )


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
def test_what_shading_moves_is_said(seed):
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
    monkeypatch.setattr(covariance, "_COMMON_DEPTH", 0.0)
    assert (both > 1.5 * camera_deviations(found, pairs).positions).all()


def test_fewer_matches_are_less_certain(monkeypatch):
    _, pairs, found = _adjusted(3, 0.5, _flat)
    few = [Pair(p.first[:, ::8], p.second[:, ::8], p.pixel) for p in pairs]
    monkeypatch.setattr(covariance, "_COMMON_DEPTH", 0.0)
    by_few, by_all = (camera_deviations(found, some).positions for some in (few, pairs))
    assert (by_few > 1.5 * by_all).all()


def test_without_matches_there_is_no_deviation():
    found = adjust(FlashSetup(fov=PHONE.fov), [], known=True)
    assert isinstance(found, Adjusted) and camera_deviations(found, []).positions.shape == (0,)
    assert camera_deviations(found, []).misregistration.shape == (0,)
