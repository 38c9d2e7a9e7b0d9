"""Cook-Torrance against physics and float64; normals and the flash's geometry."""

import math

import pytest
import torch

from matcap.brdf.cook_torrance import (
    SINGLE_ROUGHNESS,
    Angles,
    cook_torrance,
    normalize,
    specular_lobe,
)
from matcap.brdf.maps import MapSet
from matcap.brdf.normals import normals_from_height
from matcap.flash.geometry import FlashSetup, plane_points, project, unproject
from matcap.flash.render import render_flash

UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[:, None, None]


def direction(theta, phi=0.0, dtype=torch.float64):
    theta, phi = torch.as_tensor(theta, dtype=dtype), torch.as_tensor(phi, dtype=dtype)
    s = torch.sin(theta)
    return torch.stack([s * torch.cos(phi), s * torch.sin(phi), torch.cos(theta)])[..., None, None]


def scalar(value, dtype=torch.float64):
    return torch.tensor(value, dtype=dtype)[None, None, None]


@pytest.mark.parametrize("roughness", [0.05, 0.3, 0.9])
def test_reciprocal(roughness):
    a, b = direction(1.2, 0.3), direction(0.4, 2.0)
    args = (scalar(0.3).expand(3, 1, 1), scalar(0.04), scalar(roughness), UP)
    assert torch.allclose(cook_torrance(*args, a, b), cook_torrance(*args, b, a), rtol=1e-10)


@pytest.mark.parametrize("theta", [0.0, 0.8, 1.4])
@pytest.mark.parametrize("roughness", [0.2, 0.5, 1.0])
def test_furnace_never_gains_energy(theta, roughness):
    n = 512
    mu = (torch.arange(n, dtype=torch.float64) + 0.5) / n
    phi = (torch.arange(2 * n, dtype=torch.float64) + 0.5) / (2 * n) * 2 * math.pi
    sine = torch.sqrt(1 - mu**2)[:, None]
    light = torch.stack([sine * phi.cos(), sine * phi.sin(), mu[:, None].expand(n, 2 * n)])
    angles = Angles.exact(UP, light, direction(theta))
    lobe = specular_lobe(scalar(1.0), scalar(roughness), angles)
    energy = float((lobe[0] * mu[:, None]).mean() * 2 * math.pi)
    assert 0.3 < energy < 1.0 + 1e-3


def test_nothing_below_the_horizon():
    args = (scalar(0.5).expand(3, 1, 1), scalar(0.5), scalar(0.5), UP)
    below, above = direction(1.8), direction(0.3)
    assert cook_torrance(*args, below, above).abs().max() == 0
    assert cook_torrance(*args, above, below).abs().max() == 0


def quick(normal, light, view):
    return Angles.quick(normal, light, view, normalize(light + view))


@pytest.mark.parametrize("roughness", [SINGLE_ROUGHNESS, 0.1, 0.3, 1.0])
@pytest.mark.parametrize("apart", [0.0, 0.01, 0.3, 1.1])
def test_the_single_precision_lobe_is_the_lobe(roughness, apart):
    gloss = scalar(0.04), scalar(roughness)
    directions = UP, direction(0.4 + apart), direction(0.4, math.pi)
    exact = specular_lobe(*gloss, Angles.exact(*directions))
    single = specular_lobe(*(g.float() for g in gloss), quick(*(d.float() for d in directions)))
    assert single.dtype == torch.float32
    assert torch.allclose(single.double(), exact, rtol=0.01)


def test_the_single_precision_lobe_keeps_gradients_below_the_horizon():
    roughness = scalar(0.5, torch.float32).requires_grad_()
    up = UP.float()
    angles = quick(up, direction(1.7).float(), up)
    specular_lobe(scalar(0.04).float(), roughness, angles).sum().backward()
    assert torch.isfinite(roughness.grad).all() and (roughness.grad != 0.0).all()


def test_a_zero_vector_stays_zero():
    zero = torch.zeros(3, 1, 1, requires_grad=True)
    normalize(zero).sum().backward()
    assert zero.grad.abs().max() == 0


def test_normals_of_a_tilted_plane():
    points = plane_points(0, 0, 16, 12, (16, 12), dtype=torch.float64)
    height = (0.5 * points[0] - 0.25 * points[1])[None]
    expected = normalize(torch.tensor([-0.5, 0.25, 1.0], dtype=torch.float64)[:, None, None])
    found = normals_from_height(height, 2 / 16)
    assert torch.allclose(found, expected.expand_as(found), atol=1e-12)


def test_periodic_normals_wrap():
    x = torch.arange(32, dtype=torch.float64)
    height = torch.sin(2 * math.pi * x / 32).expand(1, 8, 32)
    normal = normals_from_height(height, 1.0, periodic=True)
    assert torch.allclose(normal[:, :, 0], normal.roll(32, 2)[:, :, 0])
    slope = -normal[0, 0] / normal[2, 0]
    exact = math.sin(2 * math.pi / 32) * torch.cos(2 * math.pi * x / 32)
    assert torch.allclose(slope, exact, atol=1e-12)


def test_projection_is_undone_and_tilts_turn_as_documented():
    setup = FlashSetup(tilt=(0.1, -0.2))
    points = plane_points(0, 0, 20, 15, (20, 15), dtype=torch.float64)
    assert torch.allclose(unproject(project(points, setup), setup), points, atol=1e-12)
    top, left = (
        torch.tensor(p, dtype=torch.float64)[:, None, None] for p in ([0, 0.5, 0], [-0.5, 0, 0])
    )
    # Nearer to the camera means further from the picture's middle, by more than the turn shrinks.
    assert project(top, FlashSetup(tilt=(0.1, 0.0)))[1] > 0.5
    assert project(left, FlashSetup(tilt=(0.0, 0.1)))[0] < -0.5


def test_brightness_follows_distance_squared_and_intensity():
    maps = MapSet(scalar(0.4).expand(3, 1, 1), scalar(0.04), scalar(0.5), scalar(0.0), 1.0)
    point = torch.zeros(3, 1, 1, dtype=torch.float64)
    near = FlashSetup(fov=60.0)
    far = FlashSetup(fov=math.degrees(2 * math.atan(math.tan(math.radians(30)) / 2)))
    assert far.distance == pytest.approx(2 * near.distance)
    ratio = render_flash(maps, near, point) / render_flash(maps, far, point)
    assert torch.allclose(ratio, torch.full_like(ratio, 4.0))
    double = render_flash(maps, near.with_intensity((2.0, 2.0, 2.0)), point)
    assert torch.allclose(double, 2 * render_flash(maps, near, point))
