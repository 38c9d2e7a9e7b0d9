"""Per-texel and shared parameters, octaves and heights of several photographs."""

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
from matcap.capture.multiview.shared import shared_step
from matcap.capture.multiview.solve import solve
from matcap.capture.multiview.surface import (
    cross_energies,
    denoised,
    integrated,
    prediction_error,
    surface_of,
    with_energies,
)
from matcap.capture.multiview.texels import (
    PARAMETERS,
    Estimate,
    ParameterPrior,
    derivatives,
    log_rendered,
    normal_equations,
    parameters_of,
    slopes_of,
    solved,
    solved_in_place,
)
from matcap.capture.multiview.views import RAW_FALLOFF, AmbientLight
from matcap.capture.registration.register import register
from matcap.flash.geometry import FlashSetup
from matcap.flash.light import FlashLight

# Equations of texels, and those that cannot be solved in single precision.


def _photographed(count: int, seed: int) -> tuple[torch.Tensor, ...]:
    """Residuals, weights, and derivatives by albedo and by the others of some texels."""
    generator = torch.Generator().manual_seed(seed)
    residual, share = torch.randn(2, 3, count, generator=generator)
    weight = torch.rand(3, count, generator=generator)
    return residual, weight, share, torch.randn(4, 3, count, generator=generator)


def _dense(residual, weight, share, by_others) -> tuple[torch.Tensor, torch.Tensor]:
    """(N, 7, 7) J^T W J and (N, 7) J^T W r by whole matrices."""
    jacobian = torch.cat([torch.diag_embed(share.T), by_others.permute(2, 0, 1)], dim=1)
    weighted = jacobian * weight.T[:, None]
    return weighted @ jacobian.mT, (weighted @ residual.T[..., None])[..., 0]


def test_texels_of_several_photographs_are_solved_as_by_whole_matrices() -> None:
    photographs = [_photographed(9, seed) for seed in range(5)]
    system = sum(normal_equations(*each) for each in photographs)
    matrices, rights = zip(*(_dense(*each) for each in photographs), strict=True)
    wanted = torch.linalg.solve(sum(matrices).double(), sum(rights).double()).float()
    factor = system.clone()
    torch.testing.assert_close(solved_in_place(factor)[:, 0].T, wanted, rtol=1e-2, atol=1e-3)
    lower = factor[:PARAMETERS].movedim(-1, 0).tril()
    torch.testing.assert_close(lower, torch.linalg.cholesky(sum(matrices)), rtol=1e-3, atol=1e-4)


def test_a_texel_without_a_solution_leaves_those_beside_it() -> None:
    system = sum(normal_equations(*_photographed(9, seed)) for seed in range(5))
    wanted = solved_in_place(system.clone())[:, 0]
    system[:PARAMETERS, :, 4] *= -1.0
    found = solved_in_place(system)[:, 0]
    sound = torch.arange(9) != 4
    assert torch.equal(found[:, sound], wanted[:, sound]) and bool(found[:, 4].isnan().all())


def test_texels_that_nothing_is_measured_of_keep_their_prior() -> None:
    photographs = [_photographed(9, seed) for seed in range(5)]
    system = sum(normal_equations(*each) for each in photographs)
    system[..., 4] = 0.0
    mean = torch.full((PARAMETERS, 3, 3), 0.2)
    moved, precision, _ = solved(system, torch.zeros_like(mean), mean, torch.ones_like(mean))
    torch.testing.assert_close(moved[:, 1, 1], mean[:, 1, 1])
    assert not precision[:, 1, 1].any() and bool((precision.flatten(1)[:, :4] > 0.0).all())


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
    ((log, share, by_others),) = derivatives(texels, [light])
    assert torch.equal(log, log_rendered(texels, [light])[0])
    by_albedo = torch.diag_embed(share.T).movedim(0, -1)
    for number, found in enumerate(torch.cat([by_albedo, by_others])):
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
    assert _energy(result - true) > 0.7 and _energy(found - true) < 0.1
    assert _energy(found) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("strength", [0.3, 1.0, 3.0])
def test_the_prediction_is_calibrated_for_any_strength(strength):
    true = _waves(1, 3.0)
    result, changes, _ = _estimate(true, 0.5)
    found = denoised(result, strength * true, changes)
    assert _energy(found) == pytest.approx(1.0, abs=0.07) and _energy(found - true) < 0.03
    # What was read too strong holds nothing back.
    weak = max(1.0 - strength, 0.0) ** 2
    error = prediction_error(result, strength * true, changes)[0]
    assert error == pytest.approx(weak, rel=0.15, abs=0.02)


def test_flat_relief_stays_flat():
    result, changes, _ = _estimate(np.zeros(SIZE, np.float32), 0.5)
    nothing = np.zeros(SIZE, np.float32)
    assert _energy(denoised(result, nothing, changes)) < 0.1 * _energy(result)
    assert prediction_error(result, nothing, changes)[0] < 0.1 * _energy(result)


def test_noise_of_the_first_photograph_is_no_prediction():
    true = _waves(2, 6.0)
    result, changes, first = _estimate(true, 1.0)
    assert _energy(denoised(result, first, changes) - true) < 0.3 * _energy(result - true)


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
    steep = [np.stack(np.gradient(height)) for height in (shrunk, true)]
    assert _energy(steep[0]) == pytest.approx(_energy(steep[1]), rel=0.05)
    # Halves that disagree take as much as may be taken, and no more.
    assert _energy(with_energies(true, texel, [-1.0] * 9)) == pytest.approx(0.36, abs=0.05)


# The surface whose slopes are measured, each by its precision.


SURFACE_SIZE = (75, 100)
TEXEL = 2.0 / SURFACE_SIZE[1]


@pytest.fixture(scope="module")
def slopes():
    """(2, H, W) slopes of a rough surface."""
    noise = cv2.GaussianBlur(np.random.default_rng(0).normal(size=SURFACE_SIZE), (0, 0), 1.5)
    return slopes_of(torch.from_numpy(0.5 * TEXEL * noise / noise.std()).float()[None], TEXEL)


def _precision(across, along):
    return torch.tensor([across, along, 0.0])[:, None, None].expand(3, *SURFACE_SIZE)


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
    monkeypatch.setattr(surface, "_MODEL", 1e-4)
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
    assert off < 0.1 * slopes.abs().mean() and torch.isfinite(height).all()


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
        _, moves = shared_step(views, parameters_of(found.maps), prior, found.light, moved=free)
        return [float(move[0, 2]) / flat.texel_size for move in moves]

    return by


def test_threads_of_five_texels_are_moved_by_what_they_are_off(moved):
    """Twice as far, and photographs go to and fro for ever."""
    texels = moved(())
    assert 0.3 < texels[3] < 0.5 and max(abs(texels[k]) for k in (1, 2, 4)) < 0.15


def test_a_held_photograph_stays_and_others_move(moved):
    texels = moved((0, 2, 3))
    assert abs(texels[3]) < 1e-6 and abs(texels[2]) < 1e-6 and abs(texels[1]) > 0.05


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
