"""The flash's light and least squares."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.flash.coarse.cells import log_radiance
from matcap.flash.geometry import (
    FlashSetup,
    camera_in_plane,
    plane_points,
    setup_rotation,
    unproject,
)
from matcap.flash.least_squares import jacobian, minimised
from matcap.flash.light import FlashLight, Uniform, render_flash, uniform_radiance, vignette

# The one light and the renderer of flash photographs, against formulas written out.


SETUP = FlashSetup(
    fov=65.0, offset=(0.08, 0.04, 0.0), tilt=(0.05, -0.03), intensity=(6.0, 5.0, 4.0),
    vignetting=0.3, vignetting_quartic=0.2, vignetting_centre=(0.1, -0.2),
    vignetting_colour=(0.05, 0.1, -0.15),
)  # fmt: skip
WIDTH, HEIGHT = 24, 18
ALL = slice(None)


def _points(dtype: torch.dtype = torch.float64) -> torch.Tensor:
    return plane_points(0, 0, WIDTH, HEIGHT, (WIDTH, HEIGHT), dtype=dtype)


def _maps(dtype: torch.dtype = torch.float64, smoothest: float = 0.06) -> MapSet:
    generator = torch.Generator().manual_seed(3)
    draw = lambda n: torch.rand(n, HEIGHT, WIDTH, generator=generator, dtype=torch.float64)  # noqa: E731
    return MapSet(
        0.05 + 0.8 * draw(3), 0.02 + 0.5 * draw(1), smoothest + 0.9 * draw(1),
        0.01 * draw(1), 2.0 / WIDTH,
    ).map(lambda m: m.to(dtype))  # fmt: skip


def _written_out(maps: MapSet, setup: FlashSetup, row: int, column: int) -> list[float]:
    """Radiance of one texel by the formulas as they are printed, in Python's numbers."""
    point = _points()[:, row, column].tolist()
    camera, flash = (place.tolist() for place in camera_in_plane(setup))
    normal = maps.normal[:, row, column].tolist()

    def towards(place: list[float]) -> tuple[list[float], float]:
        way = [a - b for a, b in zip(place, point, strict=True)]
        length = math.sqrt(sum(w * w for w in way))
        return [w / length for w in way], length

    def dot(a: list[float], b: list[float]) -> float:
        return sum(x * y for x, y in zip(a, b, strict=True))

    (light, distance), (view, _) = towards(flash), towards(camera)
    half = [a + b for a, b in zip(light, view, strict=True)]
    half = [h / math.sqrt(dot(half, half)) for h in half]
    n_l, n_v, n_h, l_h = dot(normal, light), dot(normal, view), dot(normal, half), dot(light, half)
    alpha = float(maps.roughness[0, row, column]) ** 2
    f0 = float(maps.specular[0, row, column])
    ggx = alpha**2 / (math.pi * (n_h**2 * (alpha**2 - 1.0) + 1.0) ** 2)

    def smith(cosine: float) -> float:
        return (math.sqrt(1.0 + alpha**2 * (1.0 / cosine**2 - 1.0)) - 1.0) / 2.0

    shadowing = 1.0 / (1.0 + smith(n_l) + smith(n_v))
    fresnel = f0 + (1.0 - f0) * (1.0 - l_h) ** 5
    lobe = ggx * shadowing * fresnel / (4.0 * n_l * n_v)
    axis = [a / math.sqrt(dot(camera, camera)) for a in camera]
    depth = math.sqrt(dot(camera, camera)) - dot(axis, point)
    turn = setup_rotation(setup).tolist()
    image = [setup.distance * dot(row, point) / depth for row in turn[:2]]
    off = [place - centre for place, centre in zip(image, setup.vignetting_centre, strict=True)]
    squared = dot(off, off) / 1.25**2
    lost = [setup.vignetting + each + setup.vignetting_quartic * squared
            for each in setup.vignetting_colour]  # fmt: skip
    return [
        (float(maps.diffuse[channel, row, column]) / math.pi + lobe)
        * setup.intensity[channel] * n_l / distance**2 * math.exp(-squared * lost[channel])
        for channel in range(3)
    ]  # fmt: skip


@pytest.mark.parametrize("exact", [True, False])
def test_radiance_equals_the_written_formula(exact: bool) -> None:
    maps = _maps()
    incidence = FlashLight.of(SETUP, _points()).onto(maps.normal, exact=exact)
    picture = incidence.radiance(maps.diffuse, maps.specular, maps.roughness)
    for row, column in ((0, 0), (5, 20), (9, 12), (17, 3)):
        expected = _written_out(maps, SETUP, row, column)
        assert picture[:, row, column].tolist() == pytest.approx(expected, rel=1e-9)


def test_single_precision_agrees_with_double() -> None:
    maps = _maps()
    exact = render_flash(maps, SETUP, _points())
    single = render_flash(_maps(torch.float32), SETUP, _points(torch.float32))
    assert torch.allclose(single.double(), exact, rtol=2e-4)
    light = FlashLight.of(SETUP, _points(torch.float32)).onto(_maps(torch.float32).normal)
    quick = light.radiance(*(m.float() for m in (maps.diffuse, maps.specular, maps.roughness)))
    assert torch.allclose(quick.double(), exact, rtol=1e-2)


@pytest.mark.parametrize("exact", [True, False])
def test_gradients_agree_with_automatic_differentiation(exact: bool) -> None:
    maps = _maps(smoothest=0.2).crop(8, 6, 4, 3)
    light = FlashLight.of(SETUP, _points()).cut(slice(6, 9), slice(8, 12))

    def picture(diffuse, specular, roughness, height):
        normal = MapSet(diffuse, specular, roughness, height, maps.texel_size).normal
        return light.onto(normal, exact=exact).radiance(diffuse, specular, roughness)

    given = [m.clone().requires_grad_() for m in maps.stacked().split([3, 1, 1, 1])]
    assert torch.autograd.gradcheck(picture, given)


def test_parts_add_up_and_places_and_batches_are_lit_alone() -> None:
    maps, light = _maps(), FlashLight.of(SETUP, _points())
    incidence = light.onto(maps.normal)
    parts = incidence.diffuse(maps.diffuse), incidence.specular(maps.specular, maps.roughness)
    picture = incidence.radiance(maps.diffuse, maps.specular, maps.roughness)
    assert torch.equal(sum(parts), picture)
    here = (slice(2, 7), slice(3, 9))
    cut = light.cut(*here).onto(maps.normal[(ALL, *here)])
    assert torch.equal(cut.diffuse(maps.diffuse[(ALL, *here)]), parts[0][(ALL, *here)])
    stacked = [torch.stack([m, 0.9 * m]) for m in (maps.diffuse, maps.specular, maps.roughness)]
    both = light.onto(maps.normal.expand(2, 3, HEIGHT, WIDTH)).radiance(*stacked)
    assert torch.equal(both[0], picture)


def test_a_surface_that_turns_away_is_dark_or_all_but() -> None:
    away = torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64)[:, None, None]
    light, maps = FlashLight.of(SETUP, _points()), _maps()
    surface = maps.diffuse, maps.specular, maps.roughness
    away = away.expand(3, HEIGHT, WIDTH)
    assert float(light.onto(away, exact=True).radiance(*surface).max()) == 0
    assert 0 < float(light.onto(away).diffuse(maps.diffuse).max()) < 1e-2


def test_a_coarse_fit_and_a_uniform_material_look_as_their_flat_maps_do() -> None:
    """Three ways to the same picture: maps, the uniform material, the fit in the camera's frame."""
    grey = replace(SETUP.with_intensity((6.0,) * 3), vignetting_colour=(0.0,) * 3)
    fit = Uniform((0.3, 0.25, 0.2), 0.04, 0.37, grey)
    image = _points()[:2]
    points = unproject(image, grey)
    one = torch.ones(1, HEIGHT, WIDTH, dtype=torch.float64)
    flat = MapSet(
        torch.tensor(fit.diffuse).double()[:, None, None] * one, 0.04 * one, 0.37 * one, 0.0 * one,
        2.0 / WIDTH,
    )  # fmt: skip
    picture = render_flash(flat, grey, points)
    largest = max(fit.diffuse)  # signed_albedo, solved for the unknown
    unsigned = ((value + 0.1 * largest) / 1.1 for value in fit.diffuse)
    parameters = (
        *(math.log(value) for value in (*unsigned, 0.04)), math.log(0.37 / 0.63),
        math.log(6.0), 0.0, 0.0,
        *grey.offset[:2], *grey.tilt, grey.vignetting, grey.vignetting_quartic,
        *grey.vignetting_centre, 0.0,
    )  # fmt: skip
    coarse = log_radiance(np.array(parameters), image.flatten(1).numpy(), grey.distance)[0]
    uniform, _ = uniform_radiance(fit, FlashLight.of(grey, points))
    np.testing.assert_allclose(np.exp(coarse.value).reshape(picture.shape), picture, rtol=1e-6)
    assert torch.allclose(uniform, picture, rtol=1e-6)


@pytest.mark.parametrize("conductor", [False, True])
def test_the_jacobian_of_the_coarse_model_is_that_of_differences(conductor):
    image = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 50))
    x = np.array(
        [-1.5, -2.0, -3.0, -3.2, -0.5, 2.0, 0.1, -0.1, 0.1, -0.05, 0.05, 0.1, 0.3, 0.5, 0.1, -0.1]
        + [0.2]
    )
    dark = x - 25.0 * (np.arange(17) < 4)  # less reflected than can be divided by
    # A conductor's share is not used.
    for here, number in [(x, 0), *([] if conductor else [(x, 1), (dark, 1)])]:

        def values(at, number=number):
            return log_radiance(at, image, 2.0, conductor=conductor)[number].value

        by = log_radiance(here, image, 2.0, conductor=conductor)[number].by
        by_differences = jacobian(values, here, 1e-6).T.reshape(by.shape)
        np.testing.assert_allclose(by, by_differences, atol=2e-3)


@pytest.mark.parametrize("share", [0.4, -0.2])
@pytest.mark.parametrize(("setting", "half_way"), [("vignetting", 4), ("vignetting_quartic", 16)])
def test_vignetting_is_its_share_at_the_corner(setting, half_way, share):
    points = torch.tensor([[[0.0, 1.0, -1.0, 0.5]], [[0.0, 0.75, -0.75, 0.375]], [[0.0] * 4]])
    log = vignette(points, FlashSetup(**{setting: share})).log()[0, 0]
    assert log.tolist() == pytest.approx([0.0, -share, -share, -share / half_way], abs=1e-6)


# The one minimiser of costs with normal equations.


def valley(x):
    """Residuals of Rosenbrock's valley, least at (1, 1)."""
    return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def slopes(x):
    """Its exact Jacobian."""
    return np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])


def cost(x):
    return float(0.5 * np.square(valley(x)).sum())


def quadratic(x):
    return slopes(x).T @ slopes(x), slopes(x).T @ valley(x)


def test_a_curved_valley_is_followed_to_its_least_cost():
    least, found = minimised(cost, quadratic, np.array([-1.2, 1.0]), 100)
    assert np.allclose(found, 1.0, atol=1e-6) and least == cost(found)


def test_no_step_is_too_far_and_none_raises_the_cost():
    start = np.array([-1.2, 1.0])
    costs = [cost(start)]
    for steps in range(1, 6):
        least, found = minimised(cost, quadratic, start, steps, farthest=0.1)
        assert np.abs(found - start).max() <= 0.1 * steps + 1e-12
        costs.append(least)
    assert costs == sorted(costs, reverse=True) and costs[-1] < costs[0]


def test_it_stays_where_every_step_is_worse():
    """The gradient points the wrong way."""
    start = np.array([0.5, 0.5])

    def wrong(x):
        hessian, gradient = quadratic(x)
        return hessian, -gradient

    least, found = minimised(cost, wrong, start, 10)
    assert np.array_equal(found, start) and least == cost(start)


def test_finite_differences_are_near_the_derivatives():
    x = np.array([-1.2, 1.0])
    np.testing.assert_allclose(jacobian(valley, x, 1e-6), slopes(x), atol=1e-4)
