"""Tilt from the perspective of a texture, on planes photographed by exact geometry."""

import math

import numpy as np
import pytest

from matcap.flash.geometry import FlashSetup, setup_rotation
from matcap.space.convergence import convergence

FOV = 60.0


def plane(tilt, texture, width=512):
    """A picture of a plane tilted by `tilt` degrees: texture(x, y) of its points, unlit."""
    setup = FlashSetup(fov=FOV, tilt=tuple(math.radians(angle) for angle in tilt))
    rotation = setup_rotation(setup).numpy()
    u, v = np.meshgrid(
        (2 * np.arange(width) + 1 - width) / width,
        (3 * width / 4 - 1 - 2 * np.arange(width * 3 // 4)) / width,
    )
    eye = np.array([0.0, 0.0, setup.distance])
    rays = np.stack([u, v, np.zeros_like(u)], axis=-1) - eye
    normal = rotation[:, 2]
    hit = eye + rays * (-(eye @ normal) / (rays @ normal))[..., None]
    shown = texture(hit @ rotation[:, 0], hit @ rotation[:, 1])
    return np.repeat((0.3 + 0.1 * shown)[..., None], 3, axis=-1).astype(np.float32)


def check(x, y):
    return np.cos(90 * x + 20 * y) + np.cos(95 * y - 15 * x)


@pytest.mark.parametrize("tilt", [(6.0, 0.0), (-4.0, 7.0), (0.0, 0.0)])
def test_a_lattice_shows_its_tilt_to_half_a_degree(tilt):
    """With a sign turned, or slopes along the other axis, errors would be as large as the tilt."""
    found = convergence(plane(tilt, check)).numpy()
    tangents = found / math.tan(math.radians(FOV / 2))
    for slope_x, slope_y, std_x, std_y in tangents:
        angles = math.degrees(math.atan(slope_y)), math.degrees(math.atan(-slope_x))
        assert angles == pytest.approx(tilt, abs=0.5)  # of first order in the tilt
        assert max(std_x, std_y) < math.radians(0.5)


def test_a_picture_without_texture_says_nothing():
    found = convergence(np.full((96, 128, 3), 0.2, np.float32)).numpy()
    assert np.abs(found[:, :2]).max() == 0.0 and found[:, 2:].min() > 0.3


def test_one_of_uneven_brightness_alone_is_square():
    """A flash beside the lens: tilt would be its only sign in a texture's brightness."""
    picture = plane((0.0, 0.0), check) * np.linspace(0.3, 1.0, 512, dtype=np.float32)[:, None]
    assert np.abs(convergence(picture).numpy()[:, :2]).max() < 0.01


@pytest.mark.parametrize("rows", [1, 2, 8, 15])
def test_a_strip_says_nothing(rows):
    strip = np.random.default_rng(0).random((rows, 4096 if rows < 3 else 256, 3), np.float32)
    assert convergence(strip)[:, :2].abs().max() == 0.0
    assert convergence(strip)[:, 2:].min() > 0.3
