"""Per-texel and shared parameters, octaves and heights of several photographs."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from seen_views import LOG_ERROR, PHONE, flattened, grainy, seen
from seen_views import SIZE as SEEN_VIEWS_SIZE

from matcap.brdf.maps import MapSet
from matcap.capture.multiview import align, surface
from matcap.capture.multiview.align import Aligned, aligned
from matcap.capture.multiview.ambient_light import AmbientLight
from matcap.capture.multiview.shared import shared_step, texels_solved
from matcap.capture.multiview.solve import solve
from matcap.capture.multiview.surface import (
    cross_energies,
    denoised,
    integrated,
    prediction_error,
    surface_of,
    texel_slopes,
    transposed,
    with_energies,
)
from matcap.capture.multiview.texels import (
    PARAMETERS,
    Estimate,
    ParameterPrior,
    derivatives,
    jacobian,
    log_rendered,
    parameters_of,
    slopes_of,
    solved_in_place,
)
from matcap.capture.multiview.views import RAW_FALLOFF
from matcap.capture.registration.register import register
from matcap.flash.geometry import FlashSetup
from matcap.flash.light import FlashLight

# Texels that cannot be told in single precision answer nothing, and end nothing.


def test_well_conditioned_texels_are_solved() -> None:
    draw = torch.randn(5, PARAMETERS, 12, generator=torch.Generator().manual_seed(0))
    within = draw @ draw.mT
    sides = torch.ones(5, PARAMETERS, 2)
    found = texels_solved(within.movedim(0, -1), sides.movedim(0, -1)).movedim(-1, 0)
    assert torch.allclose(within @ found, sides, atol=1e-2)


def test_ill_conditioned_texels_give_finite_or_zero_solutions() -> None:
    # One direction told by 1e9, all others by next to nothing: rounding makes it indefinite.
    steep = torch.linspace(0.2, 1.0, PARAMETERS)
    within = 1e9 * steep[:, None] * steep + 1e-3 * torch.eye(PARAMETERS)
    lost = within.clone()
    lost[0, 0] -= 2e3
    texels = torch.stack([within, lost, -within], dim=-1)
    found = texels_solved(texels, 1e3 * torch.ones(PARAMETERS, 1, 3))
    assert bool(torch.isfinite(found).all())
    assert float(found.abs().max()) < 1e6
    assert not found[..., 2].any()


def test_batched_systems_equal_single_ones() -> None:
    draw = torch.randn(9, PARAMETERS, 12, generator=torch.Generator().manual_seed(1))
    within, right = draw @ draw.mT, draw[..., 0]
    within[4] *= -1.0
    factor = torch.cat([within.movedim(0, -1), right.T[None]])
    found = solved_in_place(factor)[:, 0]
    sound = torch.arange(9) != 4
    wanted = torch.linalg.solve(within[sound].double(), right[sound].double()).float()
    assert torch.allclose(found.T[sound], wanted, rtol=1e-2, atol=1e-3)
    lower = factor[:PARAMETERS].movedim(-1, 0).tril()[sound]
    assert torch.allclose(lower, torch.linalg.cholesky(within[sound]), rtol=1e-3, atol=1e-4)
    assert bool(found[:, 4].isnan().all())


_POINTS = torch.cat(
    [torch.rand(2, 6, 7, generator=torch.Generator().manual_seed(2)), torch.zeros(1, 6, 7)]
)
_LIGHTS = (
    FlashLight.between(
        _POINTS.double(),
        torch.tensor([0.1, 0.0, 2.0]),
        torch.tensor([0.2, -0.1, 2.0]),
        torch.tensor([1.0, 2.0, 3.0]),
    ),
    AmbientLight(torch.tensor([0.2, 0.3, 0.5]), torch.tensor([1.0, 2.0, 3.0])[:, None, None]),
)


@pytest.mark.parametrize("light", _LIGHTS)
def test_derivatives_are_those_of_the_rendered_radiance(light) -> None:
    draw = torch.randn(PARAMETERS, 6, 7, generator=torch.Generator().manual_seed(3)).double()
    level = torch.tensor([-1.5, -1.5, -1.5, -3.0, 0.0, 0.0, 0.0])[:, None, None]
    texels = level + 0.4 * draw
    ((log, *shown),) = derivatives(texels, [light])
    assert torch.equal(log, log_rendered(texels, [light])[0])
    for number, found in enumerate(jacobian(*shown)):
        step = torch.zeros(PARAMETERS, 1, 1).double()
        step[number] = 1e-5
        ahead, behind = (log_rendered(texels + s, [light])[0] for s in (step, -step))
        torch.testing.assert_close(found, ((ahead - behind) / 2e-5).flatten(1), atol=1e-6, rtol=0)


def test_maps_beyond_their_limits_have_finite_parameters() -> None:
    """Cubic interpolation overshoots at a step, as of bare metal next to rust."""
    plane = torch.tensor([[[-0.03, 0.2, 1.04]]])
    maps = MapSet(plane.expand(3, 1, 3), plane, plane, torch.zeros(1, 1, 3), texel_size=0.01)
    assert bool(torch.isfinite(parameters_of(maps)).all())


# What photographs tell of each octave, by made photographs whose noise is known.


SIZE = (192, 256)
PHOTOGRAPHS = 5


def _waves(seed, deviation):
    """(H, W) of deviation 1, smooth over some texels."""
    noise = np.random.default_rng(seed).normal(size=SIZE)
    found = cv2.GaussianBlur(noise, (0, 0), deviation) if deviation else noise
    return np.asarray(found / found.std(), np.float32)


def _estimate(true, noise):
    """What photographs tell that are off by noise each, and what it changes without each."""
    every = np.stack([true + noise * _waves(10 + k, 0.0) for k in range(PHOTOGRAPHS)])
    result = every.mean(0)
    others = (PHOTOGRAPHS * result - every) / (PHOTOGRAPHS - 1)
    return result, list(others - result), every[0]


def _energy(found):
    return float(np.square(found).mean())


def test_denoising_keeps_the_energy():
    true = _waves(0, 6.0)
    result, changes, _ = _estimate(true, 2.0)
    found = denoised(result, np.zeros_like(true), changes)
    assert _energy(result - true) > 0.7
    assert _energy(found - true) < 0.1
    assert _energy(found) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("strength", [0.3, 1.0, 3.0])
def test_the_prediction_is_calibrated_for_any_strength(strength):
    true = _waves(1, 3.0)
    result, changes, _ = _estimate(true, 0.5)
    found = denoised(result, strength * true, changes)
    assert _energy(found) == pytest.approx(1.0, abs=0.07)
    assert _energy(found - true) < 0.03
    # What was read too strong holds nothing back.
    weak = max(1.0 - strength, 0.0) ** 2
    assert prediction_error(result, strength * true, changes)[0] == pytest.approx(
        weak, rel=0.15, abs=0.02
    )


def test_flat_relief_stays_flat():
    result, changes, _ = _estimate(np.zeros(SIZE, np.float32), 0.5)
    nothing = np.zeros(SIZE, np.float32)
    assert _energy(denoised(result, nothing, changes)) < 0.1 * _energy(result)
    assert prediction_error(result, nothing, changes)[0] < 0.1 * _energy(result)


def test_noise_of_the_first_photograph_is_no_prediction():
    true = _waves(2, 6.0)
    result, changes, first = _estimate(true, 1.0)
    found = denoised(result, first, changes)
    assert _energy(found - true) < 0.3 * _energy(result - true)


def test_relief_hidden_by_noise_is_that_of_the_prediction():
    true, fine = _waves(3, 6.0), 0.3 * _waves(4, 0.0)
    result, changes, _ = _estimate(true, 2.0)
    plain, drawn = (denoised(result, true + fine, changes, keep_energy=d) for d in (False, True))
    assert _energy(drawn) > _energy(plain) + 0.2 * _energy(fine)
    assert _energy(drawn) < 1.0 + 2.0 * _energy(fine)


def test_cross_energies_of_two_halves_are_free_of_noise():
    """Octave by octave, though noise of each is as strong as the relief."""
    true, texel = 0.01 * _waves(20, 3.0), 2.0 / SIZE[1]
    halves = [true + 0.01 * _waves(seed, 3.0) for seed in (21, 22)]
    found, exact = (cross_energies(*pair, texel) for pair in (halves, (true, true)))
    strong = np.array(exact) > 0.05 * max(exact)
    assert strong.sum() >= 2
    np.testing.assert_allclose(np.array(found)[strong], np.array(exact)[strong], rtol=0.25)


def test_relief_is_scaled_to_the_cross_energy():
    true, texel = _waves(23, 3.0), 2.0 / SIZE[1]
    shrunk = with_energies(0.8 * true, texel, cross_energies(true, true, texel))
    assert _energy(texel_slopes(shrunk)) == pytest.approx(_energy(texel_slopes(true)), rel=0.05)
    # Halves that disagree take as much as may be taken, and no more.
    least = with_energies(true, texel, [-1.0] * 9)
    assert _energy(least) == pytest.approx(0.36, abs=0.05)


# The surface whose slopes are measured, each by its precision.


SURFACE_SIZE = (75, 100)
TEXEL = 2.0 / SURFACE_SIZE[1]


@pytest.fixture(scope="module")
def slopes():
    """(2, H, W) slopes of a rough surface."""
    noise = cv2.GaussianBlur(np.random.default_rng(0).normal(size=SURFACE_SIZE), (0, 0), 1.5)
    return slopes_of(torch.from_numpy(0.5 * TEXEL * noise / noise.std()).float()[None], TEXEL)


def _precision(across, along):
    each = [across, along, 0.0]
    return torch.tensor(each)[:, None, None].expand(3, *SURFACE_SIZE)


def _off(height, slopes):
    left = slopes_of(height, TEXEL) - slopes
    return float(left.square().mean().sqrt() / slopes.square().mean().sqrt())


def test_slopes_of_a_surface_are_recovered(slopes):
    assert _off(surface_of(slopes, TEXEL, _precision(100.0, 100.0)), slopes) < 0.01


def test_slopes_measured_along_one_direction_determine_the_other(slopes, monkeypatch):
    """As two photographs do: slopes to a side are measured, those across it are noise."""
    generator = torch.Generator().manual_seed(1)
    noise = torch.tensor([0.01, 1.0])[:, None, None] * slopes.std()
    seen = slopes + noise * torch.randn(slopes.shape, generator=generator)
    known = _precision(*(noise[:, 0, 0] ** -2).tolist())
    monkeypatch.setattr(surface, "_MODEL", 0.0)
    found = surface_of(seen, TEXEL, known)
    assert _off(found, slopes) < 0.3 * _off(integrated(seen, TEXEL), slopes)


def test_unknown_slopes_do_not_move_their_surroundings(slopes):
    wrong = slopes.clone()
    wrong[:, 30:45, 40:60] = 3.0
    known = _precision(100.0, 100.0).clone()
    known[:, 30:45, 40:60] = 1e-6
    height = surface_of(wrong, TEXEL, known)
    away = torch.ones(SURFACE_SIZE, dtype=torch.bool)
    away[25:50, 35:65] = False
    off = (slopes_of(height, TEXEL) - slopes)[:, away].abs().mean()
    assert off < 0.1 * slopes.abs().mean()
    assert torch.isfinite(height).all()


@pytest.mark.parametrize("size", [(8, 9), (31, 40)])
def test_the_gradient_is_the_slopes_transpose(size):
    rng = np.random.default_rng(2)
    height, slopes = (rng.normal(size=s).astype(np.float32) for s in (size, (2, *size)))
    both = np.vdot(texel_slopes(height), slopes), np.vdot(height, transposed(slopes))
    assert both[0] == pytest.approx(both[1], rel=1e-4)


# Registration by rendering: misregistered photographs move, certain ones stay.


RIBS = 4.7  # texels


def _woven(astray=0.0, size=SEEN_VIEWS_SIZE):
    """A flat weave, shifted by `astray` texels to the right."""
    texel = 2.0 / size[1]
    x, y = torch.arange(size[1]) - astray, torch.arange(size[0])[:, None]
    threads = torch.sin(2.0 * torch.pi * x / RIBS) + torch.sin(2.0 * torch.pi * y / RIBS)
    return MapSet(
        diffuse=(0.2 * (0.2 * threads).exp()).float().expand(3, -1, -1).contiguous(),
        specular=torch.full((1, *size), 0.04),
        roughness=torch.full((1, *size), 0.6),
        height=torch.zeros(1, *size),
        texel_size=texel,
    )


@pytest.fixture(scope="module")
def moved():
    """Texels by which each of five photographs is moved, if the fourth is 0.4 texels off."""
    views, light = seen([_woven(), _woven(), _woven(), _woven(0.4), _woven()])
    flat = flattened(_woven())
    log_error = LOG_ERROR.expand(4, *SEEN_VIEWS_SIZE)
    light = replace(light, vignetting_deviation=RAW_FALLOFF)
    read = Estimate(flat, log_error)
    found = solve(views, read, light)

    def by(held):
        prior = ParameterPrior.of(read)
        free = set(range(5)).difference(held)
        numbers = parameters_of(found.maps)
        _, moves = shared_step(views, numbers, prior, found.light, moved=free)
        return [float(move[0, 2]) / flat.texel_size for move in moves]

    return by


def test_threads_of_five_texels_are_moved_by_what_they_are_off(moved):
    """Twice as far, and photographs go to and fro for ever."""
    texels = moved(())
    assert 0.3 < texels[3] < 0.5
    assert max(abs(texels[k]) for k in (1, 2, 4)) < 0.15


def test_a_held_photograph_stays_and_others_move(moved):
    texels = moved((0, 2, 3))
    assert abs(texels[3]) < 1e-6 and abs(texels[2]) < 1e-6
    assert abs(texels[1]) > 0.05


@pytest.fixture(scope="module")
def laid(held):
    """Photographs of plaster before and after alignment, with a misregistration by features."""
    _, photos = held
    found = register(photos, FlashSetup(fov=PHONE.fov))
    maps = flattened(grainy(0, (96, 128)))
    setup = found.setup.with_intensity((5.0, 5.0, 5.0))
    log_error = LOG_ERROR.expand(4, 96, 128)

    def over(astray):
        views = tuple(replace(view, misregistration=astray) for view in found.views)
        lines = []
        begun = Aligned.of((found.views[0], *views[1:]), setup)
        by = aligned(begun, Estimate(maps, log_error), on_progress=lines.append)
        return found, by, len(lines)

    return over


def test_precisely_registered_photographs_stay_and_relief_is_recovered(laid):
    found, by, grids = laid(1e-4)
    assert grids == 2  # the finest tells nothing more of relief
    for before, after in zip(found.views, by.views, strict=True):
        assert (before.camera.place == after.camera.place).all()
        assert before.position_deviation == after.position_deviation
    assert np.ptp(by.relief) > 0.0


def test_imprecisely_registered_photographs_are_moved_until_they_settle(laid, monkeypatch):
    for name, value in (("LEVELS", (0.5, 1.0)), ("ROUNDS", (3, 3)), ("STEPS", (1, 0))):
        monkeypatch.setattr(align, f"_{name}", value)
    monkeypatch.setattr(align, "_SETTLED", 0.0)
    found, by, every = laid(1.0)
    assert every == 6
    for before, after in zip(found.views[1:], by.views[1:], strict=True):
        assert (before.camera.place != after.camera.place).any()
        assert after.position_deviation == align._REMAINING * before.position_deviation
    monkeypatch.setattr(align, "_SETTLED", 100.0)
    _, _, settled = laid(1.0)
    assert settled == 2
