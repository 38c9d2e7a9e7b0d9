"""Periodic weaves, whose photographs could be registered a period off."""

import cv2
import numpy as np
import pytest
from simulated.photographs import Hand, PhoneCamera, hold

from matcap.capture.registration.keypoints import is_periodic
from matcap.capture.registration.register import register
from matcap.flash.geometry import FlashSetup
from matcap.photo.photo import Photo

PHONE = PhoneCamera(width=480, height=360)
FINE = 2  # samples along a pixel's side


def _smooth(rng, deviation):
    noise = cv2.GaussianBlur(rng.normal(size=(1024, 1024)).astype(np.float32), (0, 0), deviation)
    return noise / noise.std()


def _weave(thread, clouds, flaws):
    """Albedo of plane points (3, h, w): threads of a width; log contrast of clouds and flaws."""
    rng = np.random.default_rng(1)
    irregular = clouds * _smooth(rng, 30.0) + flaws * _smooth(rng, 1.0)

    def albedo(points):
        x = np.cos(0.2) * points[0] + np.sin(0.2) * points[1]
        y = np.cos(0.2) * points[1] - np.sin(0.2) * points[0]
        u, v = np.sin(np.pi * x / thread), np.sin(np.pi * y / thread)
        woven = np.where(u * v > 0.0, np.abs(u) ** 0.7, 0.75 * np.abs(v) ** 0.7)
        place = [((p + 2.0) * 255.75).astype(np.float32) for p in points[:2]]
        return (0.1 + 0.4 * woven) * np.exp(cv2.remap(irregular, *place, cv2.INTER_LINEAR))

    return albedo


def _photographs(albedo):
    """Cameras, and their flash photographs of an albedo."""
    cameras, photos = hold(PHONE, Hand(), 2, 5), []
    columns, rows = PHONE.width * FINE, PHONE.height * FINE
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    image = np.stack([x - columns / 2.0, rows / 2.0 - y]) / (columns / 2.0)
    for number, camera in enumerate(cameras):
        points = camera.on_plane(image)
        away = camera.flash((0.04, -0.07, 0.0))[:, None, None] - points
        lit = albedo(points) * away[2] / np.square(away).sum(0) ** 1.5
        small = cv2.resize(
            lit / lit.max(), (PHONE.width, PHONE.height), interpolation=cv2.INTER_AREA
        )
        noise = np.random.default_rng(number).normal(size=(*small.shape, 3))
        pixels = (0.9 * small[..., None] + 0.003 * noise).clip(1e-4, 1.0).astype(np.float32)
        clipped = (pixels >= 1.0).any(-1)
        size = (PHONE.width, PHONE.height)
        photos.append(Photo(pixels, clipped, PHONE.fov, "exif", True, f"p{number}", size))
    return cameras, photos


@pytest.mark.parametrize(("thread", "clouds", "flaws"), [(0.04, 0.1, 0.1), (0.1, 0.1, 0.05)])
def test_a_weave_with_flaws_is_laid_in_its_place(thread, clouds, flaws):
    cameras, photos = _photographs(_weave(thread, clouds, flaws))
    found = register(photos, FlashSetup(fov=PHONE.fov))
    assert len(found.views) == 2 and is_periodic(photos[0])
    points = np.stack([*np.random.default_rng(0).uniform(-0.5, 0.5, (2, 200)), np.zeros(200)])
    first, second = (view.camera for view in found.views)
    there = second.on_plane(cameras[1].sees(cameras[0].on_plane(first.sees(points))))
    assert np.hypot(*(there - points)[:2]).max() < 0.1 * thread


def test_a_weave_without_a_flaw_is_refused_in_a_sentence():
    _, photos = _photographs(_weave(0.04, 0.0, 0.0))
    found = register(photos, FlashSetup(fov=PHONE.fov))
    (refused,) = found.left_out
    assert "pattern repeats" in refused.why and "border" in refused.why


def test_grain_does_not_repeat_itself():
    _, photos = _photographs(_weave(1e9, 0.1, 0.3))  # of one thread
    assert not is_periodic(photos[0])
