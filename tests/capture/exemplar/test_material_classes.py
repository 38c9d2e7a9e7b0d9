"""Material classes, mean parameters, metals and their tint."""

from dataclasses import replace

import pytest
import torch
from photographed import SETUP, even, photographed

from matcap.brdf.cook_torrance import METAL_F0, SurfaceParameters
from matcap.capture.exemplar.mean_parameters import (
    MeanParameterPrior,
    RingTarget,
    _RingFit,
    fit_mean_parameters,
)
from matcap.capture.exemplar.predict import BY_HEIGHT, Classes, find_mixture, metal_score
from matcap.flash.geometry import flash_mirror_point
from matcap.flash.light import FlashLight, Uniform, render_flash

# Material classes: metal and a dielectric separated, each with levels of its own.


HEIGHT, WIDTH = 96, 128
GOLD = torch.tensor(METAL_F0["gold"])[:, None, None]
BOLE = torch.tensor([0.24, 0.06, 0.03])[:, None, None]


def patches(part: int = 2) -> torch.Tensor:
    """(1, H, W) a board of 0 and 1, one in `part` squares 1."""
    y, x = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    return ((x // 8 + y // 8) % part == part - 1)[None].float()


def photograph(metal: torch.Tensor, brightness: float = 1.0):
    """(what is shown, residuals of the truth, residuals as a network in doubt reads them)."""
    shot = photographed(0.15, 0.1, width=WIDTH, height=HEIGHT)
    one = torch.ones(1, HEIGHT, WIDTH)
    maps = replace(
        shot.maps,
        diffuse=0.004 * metal + BOLE * (1.0 - metal),
        specular=0.9 * GOLD * metal + 0.04 * (1.0 - metal),
        roughness=0.3 * metal + 0.7 * (1.0 - metal),
    )
    linear = brightness * render_flash(maps, shot.uniform.setup, shot.points)
    light = shot.light
    grey = replace(maps, specular=maps.specular.mean(0, keepdim=True))
    truth = light.residuals(grey)
    read = replace(
        truth,
        diffuse=light.residuals(replace(grey, diffuse=0.08 * one + 0.0 * BOLE)).diffuse,
        specular=light.residuals(replace(grey, specular=0.1 * one)).specular,
        roughness=light.residuals(replace(grey, roughness=0.45 * one)).roughness,
    )
    return target(shot, linear, light.maps(read).normal, light.uniform), truth, read


def target(shot, linear, normal, surface, setup=SETUP, limit: float = 1.0) -> RingTarget:
    """Rings of a photograph that is clipped at a limit."""
    x, y = flash_mirror_point(setup)
    return RingTarget(
        linear=linear.clamp_max(limit),
        measured=linear < limit,
        counts=torch.ones(linear.shape[1:], dtype=torch.bool),
        distance=torch.hypot(shot.points[0] - x, shot.points[1] - y),
        flash=FlashLight.of(setup, shot.points),
        normal=normal,
        surface=surface,
        limit=limit,
    )


def doubtful(metal: torch.Tensor, noise: float = 0.5) -> torch.Tensor:
    """A logit that is right about borders, wrong about one texel in six at 0.5, and drifts."""
    grain = noise * torch.randn(metal.shape, generator=torch.Generator().manual_seed(2))
    return metal - 0.5 + grain + torch.linspace(3.0, 0.0, WIDTH)


def reached(mixture: Classes, shown: RingTarget) -> tuple[torch.Tensor, torch.Tensor]:
    """(2,) F0 and (2, 3) albedo of metal and of the rest."""
    levels = (shown.surface.vector() + mixture.mean_parameters).exp()
    return levels[:, 3], levels[:, :3]


@pytest.mark.parametrize(
    ("brightness", "part", "noise"), [(0.05, 2, 0.5), (1.0, 2, 0.5), (0.05, 5, 0.15)]
)
def test_each_class_has_its_own_parameters_though_they_were_predicted_alike(
    brightness: float, part: int, noise: float
) -> None:
    metal = patches(part)
    shown, _, read = photograph(metal, brightness)
    assert (float((~shown.measured).float().mean()) > 0.02) == (brightness == 1.0)
    mixture = find_mixture(read, doubtful(metal, noise), shown)
    assert mixture is not None
    assert float(((mixture.metal_share > 0.5) == (metal > 0.5)).float().mean()) > 0.9
    f0, albedo = reached(mixture, shown)
    assert float(f0[0]) == pytest.approx(brightness * 0.9 * float(GOLD.mean()), rel=0.3)
    assert float(f0[0] / f0[1]) > 6.0  # 16 in truth, 1 as read
    assert float((albedo[1] / (brightness * BOLE.flatten()) - 1.0).abs().max()) < 0.4
    assert float(albedo[0].max()) < (0.02 if part == 2 else 0.03) * brightness


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_one_class_is_not_taken_for_two(share: float) -> None:
    metal = patches()
    shown, _, read = photograph(share * torch.ones_like(metal))
    assert find_mixture(read, doubtful(metal), shown) is None


EVEN_GLOSS = torch.ones(HEIGHT, WIDTH)


def test_albedo_of_dielectrics_and_f0_of_metal_vary_by_texel() -> None:
    metal = patches()
    _, truth, _ = photograph(metal)
    levels = torch.tensor([[0.1] * 5, [-0.2] * 5])
    classes = Classes(torch.cat([metal, 1.0 - metal]), (True, False), levels)
    grain = 0.1 * torch.sin(torch.arange(WIDTH) * 1.7).expand(1, HEIGHT, WIDTH)
    noisy = replace(truth, diffuse=truth.diffuse + grain, specular=truth.specular + grain)
    constrained, plain = (classes.constrained(each, EVEN_GLOSS) for each in (noisy, truth))
    assert torch.allclose(classes.class_means(constrained), levels, atol=1e-4)
    assert torch.equal(constrained.height, truth.height)
    bare = metal[0] > 0.5
    off = constrained.specular - plain.specular - grain
    assert float(off[:, bare].std()) < 1e-3 and float(constrained.specular[:, ~bare].std()) < 1e-5
    assert float(constrained.diffuse[:, bare].std()) < 1e-5


@pytest.mark.parametrize("slopes", [(0.2, 0.2), (-0.4, 0.3)])
def test_roughness_follows_height_in_each_class(slopes: tuple[float, float]) -> None:
    torch.manual_seed(5)
    height, noise, tone = torch.randn(3, 1, HEIGHT, WIDTH)
    first = (torch.arange(WIDTH) < WIDTH // 2).float().expand(1, HEIGHT, WIDTH)
    classes = Classes(torch.cat([first, 1.0 - first]), (True, False), torch.zeros(2, 5))
    slope = slopes[0] * first + slopes[1] * (1.0 - first)
    predicted = SurfaceParameters(
        diffuse=tone.expand(3, -1, -1),
        specular=torch.zeros_like(tone),
        roughness=slope * height + 0.2 * tone + 0.2 * noise,
        height=height,
    )
    rough = classes.constrained(predicted, EVEN_GLOSS).roughness
    for number, one in enumerate(classes.shares):
        h, r = height[0][one > 0.5], rough[0][one > 0.5]
        found = (h * r).mean() / (h * h).mean()
        assert float(found) == pytest.approx(BY_HEIGHT * slopes[number], abs=0.06)
        assert float((r - found * h).std()) < 0.1


def test_flat_and_even_texels_have_one_roughness() -> None:
    even = torch.zeros(1, HEIGHT, WIDTH)
    predicted = SurfaceParameters(even.expand(3, -1, -1), even, torch.randn_like(even), even)
    constrained = Classes.whole((HEIGHT, WIDTH), metal=False).constrained(predicted, EVEN_GLOSS)
    assert constrained.roughness.abs().max() < 1e-5


def test_metal_is_separated_from_a_drift() -> None:
    metal = patches()
    _, truth, _ = photograph(metal)
    score = metal_score(truth, doubtful(metal))
    assert float(score.std()) == pytest.approx(1.0, abs=0.01)
    assert float(((score > 0.0) == (metal > 0.5)).float().mean()) > 0.95


def test_a_prediction_without_texture_is_one_class() -> None:
    shown, truth, read = photograph(torch.zeros(1, HEIGHT, WIDTH))
    flat = 0.0 * doubtful(patches())
    assert torch.isfinite(metal_score(truth, flat)).all()
    assert find_mixture(read, flat, shown) is None


# Levels of gloss from the profile of the highlight.


ONE = torch.ones(1, 192, 256)
PRIOR = MeanParameterPrior(torch.zeros(1, 5), torch.tensor([[1.0, 1.0, 1.0, 0.15, 1.0]]))


def glossy(roughness: float, brightness: float = 1.0, limit: float = 1.0):
    """A photograph of an even dielectric with relief, and the surface that it is fitted from."""
    shot = even(photographed(0.05, 0.0, width=256, height=192), 0.2, roughness)
    gain = 0.3 * brightness / float(shot.linear.median())
    setup = SETUP.with_intensity(tuple(gain * power for power in SETUP.intensity))
    uniform = Uniform((0.3, 0.3, 0.3), 0.04, 0.5, setup)
    surface, normal = uniform.parameters(), shot.maps.normal
    return target(shot, gain * shot.linear, normal, surface, setup, limit), uniform


def fitted(shown: RingTarget, uniform: Uniform) -> tuple[float, float, float]:
    """Mean albedo, F0 and roughness."""
    levels, _ = fit_mean_parameters(shown, ONE, torch.zeros(1, 5), PRIOR)
    found = (uniform.parameters() + SurfaceParameters.from_vector(levels[0])).reflectance()
    return float(found.diffuse.mean()), float(found.specular), float(found.roughness)


@pytest.mark.parametrize("roughness", [0.2, 0.35, 0.6])
def test_mean_parameters_are_recovered_under_relief(roughness: float) -> None:
    albedo, f0, found = fitted(*glossy(roughness, 0.2))
    assert albedo == pytest.approx(0.2, rel=0.1) and f0 == pytest.approx(0.04, rel=0.15)
    assert found == pytest.approx(roughness, rel=0.1)


def test_a_clipped_core_is_a_lower_bound() -> None:
    shown, uniform = glossy(0.25)
    assert 0.01 < float((~shown.measured).float().mean()) < 0.1
    assert fitted(shown, uniform)[2] == pytest.approx(0.25, rel=0.1)


@pytest.mark.parametrize("limit", [8.0, float("inf")])
def test_light_above_white_is_measured(limit: float) -> None:
    shown, uniform = glossy(0.2, 2.0, limit)
    assert float(shown.linear.max()) > 4.0
    albedo, f0, found = fitted(shown, uniform)
    assert (albedo, f0) == (pytest.approx(0.2, rel=0.1), pytest.approx(0.04, rel=0.15))
    assert found == pytest.approx(0.2, rel=0.1)


def test_what_is_clipped_everywhere_is_raised_and_never_lowered() -> None:
    shown, uniform = glossy(0.6, 0.2)
    nothing = replace(shown, measured=torch.zeros_like(shown.measured))
    bright = replace(nothing, surface=nothing.surface + _paler(1.0))
    levels, _ = fit_mean_parameters(bright, ONE, torch.zeros(1, 5), PRIOR)
    assert float(levels.abs().max()) < 0.05
    dark = replace(nothing, surface=nothing.surface + _paler(-2.0))
    levels, _ = fit_mean_parameters(dark, ONE, torch.zeros(1, 5), PRIOR)
    assert float(levels[0, :3].min()) > 0.5


def _paler(by: float) -> SurfaceParameters:
    return SurfaceParameters.from_vector(torch.tensor([by, by, by, 0.0, 0.0]))


def test_the_linearisation_is_the_derivative_of_the_residuals() -> None:
    shown, _ = glossy(0.4, 0.3)
    fit = _RingFit(shown, ONE, PRIOR)
    theta = torch.tensor([0.1, -0.1, 0.05, 0.02, 0.2])
    residual, columns = fit._linear(theta)
    assert torch.allclose(residual, fit.residuals(theta), atol=1e-4)
    for k, step in enumerate(0.01 * torch.eye(5)):
        slope = (fit.residuals(theta + step) - fit.residuals(theta - step)) / 0.02
        assert torch.allclose(-slope, columns[k], atol=0.03 * float(columns.abs().max()))
