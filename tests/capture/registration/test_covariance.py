"""How far cameras may be off is said, and is as far as they are."""

import numpy as np
import pytest

from matcap.capture.registration import covariance
from matcap.capture.registration.adjust import Adjusted, Pair, adjust
from matcap.capture.registration.covariance import camera_deviations
from matcap.flash.geometry import FlashSetup
from matcap.lab.simulate.hand_held import Hand, hold
from matcap.lab.simulate.photograph import PhoneCamera
from matcap.photo.checks import CHECKS

PHONE = PhoneCamera(width=800, height=600)
PIXEL = 1.0 / 400.0
(UNCERTAIN,) = CHECKS["cameras"].limits


def _matched(seed, noise, depths, count=800):
    """Cameras, and matches of features off by pixels, that seem to lie so deep to every flash."""
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
    return cameras, pairs


def _adjusted(seed, noise, depths):
    """True cameras, matches, and what is fitted to them."""
    true, pairs = _matched(seed, noise, depths)
    return true, pairs, adjust(FlashSetup(fov=PHONE.fov), pairs, known=True)


def _off(true, found):
    first = found.cameras[0]
    return np.array(
        [
            np.linalg.norm(
                first.turn @ (camera.place - first.place)
                - true[0].turn @ (other.place - true[0].place)
            )
            / np.linalg.norm(other.place)
            for camera, other in zip(found.cameras[1:], true[1:], strict=True)
        ]
    )


def _beside(true, found):
    """Plane units that photographs lie beside the first, where both show the plane."""
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
    """All of a kind, as leather's cells: twice as deep as they scatter."""
    return rng.normal(0.014, 0.007, count)


def test_features_of_a_flat_piece_leave_no_doubt():
    _, pairs, found = _adjusted(1, 0.1, _flat)
    assert camera_deviations(found, pairs).positions.max() < UNCERTAIN


def test_shading_that_moves_cameras_is_said():
    for seed in range(3):
        true, pairs, found = _adjusted(seed, 0.4, _bumps)
        off, said = _off(true, found), camera_deviations(found, pairs).positions
        assert off.max() > UNCERTAIN  # else this tells nothing
        assert (said[off > UNCERTAIN] > UNCERTAIN).all()
        # Neither lulls nor cries wolf.
        assert 0.3 < np.sqrt(np.mean((off / said) ** 2)) < 2.0


def test_how_far_photographs_lie_beside_each_other_is_said():
    for seed in range(3):
        true, pairs, found = _adjusted(seed, 0.4, _bumps)
        off, said = _beside(true, found), camera_deviations(found, pairs).misregistration
        assert 0.3 < np.sqrt(np.mean((off / said) ** 2)) < 2.0
    _, pairs, found = _adjusted(0, 0.1, _flat)
    assert (camera_deviations(found, pairs).misregistration < 0.25 * said).all()


@pytest.mark.parametrize("more", [1.0, 2.0])
def test_more_scatter_is_more_doubt(more, monkeypatch):
    _, pairs, found = _adjusted(2, 0.4, lambda rng, count: more * _bumps(rng, count))
    both = camera_deviations(found, pairs).positions
    monkeypatch.setattr(covariance, "_COMMON_DEPTH", 0.0)
    assert (both > 1.5 * camera_deviations(found, pairs).positions).all()


def test_fewer_matches_are_more_doubt(monkeypatch):
    _, pairs, found = _adjusted(3, 0.5, _flat)
    few = [Pair(p.first[:, ::8], p.second[:, ::8], p.pixel) for p in pairs]
    monkeypatch.setattr(covariance, "_COMMON_DEPTH", 0.0)
    assert (
        camera_deviations(found, few).positions > 1.5 * camera_deviations(found, pairs).positions
    ).all()


def test_nothing_is_said_where_nothing_is_matched():
    found = adjust(FlashSetup(fov=PHONE.fov), [], known=True)
    assert isinstance(found, Adjusted) and camera_deviations(found, []).positions.shape == (0,)
    assert camera_deviations(found, []).misregistration.shape == (0,)
