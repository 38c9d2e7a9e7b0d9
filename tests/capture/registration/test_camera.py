"""Cameras over the plane, and bundle adjustment of them."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from simulated.photographs import Hand, PhoneCamera, hold, relative_position

from matcap.capture.registration import adjust as adjustment
from matcap.capture.registration.adjust import Pair, adjust
from matcap.capture.registration.camera import Lens, PosedCamera, grid_points
from matcap.flash.geometry import FlashSetup, project

SETUP = FlashSetup(fov=65.0, tilt=(0.1, -0.05))
POINTS = grid_points(16, 12)
PHONE = PhoneCamera(width=800, height=600)


@pytest.mark.parametrize("bent", [(0.0, 0.0), (0.03, -0.01), (-0.03, 0.01)])
def test_what_a_camera_sees_is_where_it_sees_it(bent):
    camera = PosedCamera.of(SETUP, bent)
    np.testing.assert_allclose(camera.on_plane(camera.sees(POINTS)), POINTS, atol=1e-9)


def test_a_photographs_own_camera_is_the_planes():
    camera = PosedCamera.of(SETUP)
    expected = project(torch.from_numpy(POINTS), SETUP)
    np.testing.assert_allclose(camera.sees(POINTS), expected, atol=1e-12)
    assert camera.tilt == pytest.approx(math.acos(math.cos(0.1) * math.cos(-0.05)))


def test_what_lies_behind_is_not_seen():
    camera = PosedCamera(np.diag([1.0, 1.0, 1.0]), np.array([0.0, 0.0, -1.0]), Lens(1.5))
    assert np.isnan(camera.sees(POINTS)).all()


def _pairs(cameras, noise=0.0):
    rng = np.random.default_rng(1)
    points = POINTS.reshape(3, -1)
    seen = [camera.sees(points) for camera in cameras]
    pairs = []
    for other in seen[1:]:
        both = (np.abs(seen[0]).max(0) < 1.0) & (np.abs(other).max(0) < 1.0)
        off = noise * rng.normal(size=(2, int(both.sum())))
        pairs.append(Pair(seen[0][:, both], other[:, both] + off, 1.0 / 800.0))
    return pairs


def test_exact_matches_give_the_cameras_back(monkeypatch):
    cameras = hold(PHONE, Hand(bent=(0.02, -0.005)), 5, 2)
    monkeypatch.setattr(adjustment, "_COUNTED", 1e6)
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


def test_a_wrong_start_is_left_behind():
    cameras = hold(PHONE, Hand(), 4, 4)
    leaning = replace(FlashSetup(fov=PHONE.fov), tilt=(0.08, -0.06))
    found = adjust(leaning, _pairs(cameras), known=True)
    true = PosedCamera.of(FlashSetup(fov=PHONE.fov, tilt=found.first.tilt))
    assert np.abs(true.turn - cameras[0].turn).max() < 0.01
