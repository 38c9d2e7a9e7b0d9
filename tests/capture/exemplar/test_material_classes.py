"""Material classes, mean parameters, metals and their tint."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from photographed import photographed

from matcap.brdf.cook_torrance import METAL_F0, SurfaceParameters
from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.material_classes import (
    BY_HEIGHT,
    Classes,
    Mixture,
    find_mixture,
    has_metal,
    metal_score,
    seen_colour,
    specular_tint,
)
from matcap.capture.exemplar.mean_parameters import (
    MeanParameterPrior,
    RingTarget,
    _RingFit,
    diffuse_share_residual,
    fit_mean_parameters,
    most_probable_scale,
    scaled,
)
from matcap.capture.exemplar.network.network import ExpectedErrors
from matcap.capture.exemplar.refine import refine_albedo
from matcap.example.exemplar import Exemplar
from matcap.flash.diffuse_share import DiffuseRings
from matcap.flash.geometry import FlashSetup, flash_mirror_point
from matcap.flash.light import FlashLight, Uniform, render_flash, render_rectified

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
    x, y = flash_mirror_point(shot.uniform.setup)
    shown = RingTarget(
        linear=linear.clamp_max(1.0),
        measured=linear < 1.0,
        counts=torch.ones(HEIGHT, WIDTH, dtype=torch.bool),
        distance=torch.hypot(shot.points[0] - x, shot.points[1] - y),
        flash=light.flash,
        normal=light.maps(read).normal,
        surface=light.uniform,
    )
    return shown, truth, read


def doubtful(metal: torch.Tensor, noise: float = 0.5) -> torch.Tensor:
    """A logit that is right about borders, wrong about one texel in six at 0.5, and drifts."""
    draw = torch.Generator().manual_seed(2)
    grain = noise * torch.randn(metal.shape, generator=draw)
    return metal - 0.5 + grain + torch.linspace(3.0, 0.0, WIDTH)


def reached(mixture: Mixture, shown: RingTarget) -> tuple[torch.Tensor, torch.Tensor]:
    """(2,) F0 and (2, 3) albedo of metal and of the rest."""
    levels = (shown.surface.vector() + mixture.classes.mean_parameters).exp()
    return levels[:, 3], levels[:, :3]


@pytest.mark.parametrize(
    ("brightness", "part", "noise"), [(0.05, 2, 0.5), (1.0, 2, 0.5), (0.05, 5, 0.15)]
)
def test_each_class_has_its_own_parameters_though_they_were_predicted_alike(
    brightness: float, part: int, noise: float
) -> None:
    metal = patches(part)
    shown, _, read = photograph(metal, brightness)
    clipped = float((~shown.measured).float().mean())
    assert (clipped > 0.02) == (brightness == 1.0)
    mixture = find_mixture(read, doubtful(metal, noise), shown)
    assert mixture.likely(shown.surface)
    right = ((mixture.classes.metal_share > 0.5) == (metal > 0.5)).float().mean()
    assert float(right) > 0.9
    f0, albedo = reached(mixture, shown)
    assert float(f0[0]) == pytest.approx(brightness * 0.9 * float(GOLD.mean()), rel=0.3)
    assert float(f0[0] / f0[1]) > 6.0  # 16 in truth, 1 as read
    assert float((albedo[1] / (brightness * BOLE.flatten()) - 1.0).abs().max()) < 0.4
    assert float(albedo[0].max()) < (0.02 if part == 2 else 0.03) * brightness


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_one_class_is_not_taken_for_two(share: float) -> None:
    metal = patches()
    shown, _, read = photograph(share * torch.ones_like(metal))
    mixture = find_mixture(read, doubtful(metal), shown)
    assert not mixture.likely(shown.surface)


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
    assert float(off[:, bare].std()) < 1e-3
    assert float(constrained.specular[:, ~bare].std()) < 1e-5
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
    right = ((score > 0.0) == (metal > 0.5)).float().mean()
    assert float(right) > 0.95


def test_a_prediction_without_texture_is_one_class() -> None:
    shown, truth, read = photograph(torch.zeros(1, HEIGHT, WIDTH))
    flat = 0.0 * doubtful(patches())
    assert torch.isfinite(metal_score(truth, flat)).all()
    mixture = find_mixture(read, flat, shown)
    assert torch.isfinite(mixture.classes.mean_parameters).all()
    assert not mixture.likely(shown.surface)


# Levels of gloss from the profile of the highlight.


MEAN_PARAMETERS_HEIGHT, MEAN_PARAMETERS_WIDTH = 192, 256
ONE = torch.ones(1, MEAN_PARAMETERS_HEIGHT, MEAN_PARAMETERS_WIDTH)
PRIOR = MeanParameterPrior(torch.zeros(1, 5), torch.tensor([[1.0, 1.0, 1.0, 0.15, 1.0]]))


def glossy(
    roughness: float, brightness: float = 1.0, limit: float = 1.0
) -> tuple[RingTarget, Uniform]:
    """A photograph of an even dielectric with relief, and the surface that it is fitted from."""
    shot = photographed(0.05, 0.0, width=MEAN_PARAMETERS_WIDTH, height=MEAN_PARAMETERS_HEIGHT)
    maps = replace(
        shot.maps,
        diffuse=0.2 * ONE.expand(3, -1, -1),
        specular=0.04 * ONE,
        roughness=roughness * ONE,
    )
    linear = render_flash(maps, shot.uniform.setup, shot.points)
    linear = linear * (0.3 / linear.median()) * brightness
    gain = float(linear.median() / render_flash(maps, shot.uniform.setup, shot.points).median())
    intensity = tuple(gain * power for power in shot.uniform.setup.intensity)
    setup = shot.uniform.setup.with_intensity(intensity)
    uniform = Uniform((0.3, 0.3, 0.3), 0.04, 0.5, setup)
    x, y = flash_mirror_point(setup)
    target = RingTarget(
        linear=linear.clamp_max(limit),
        measured=linear < limit,
        counts=torch.ones(MEAN_PARAMETERS_HEIGHT, MEAN_PARAMETERS_WIDTH, dtype=torch.bool),
        distance=torch.hypot(shot.points[0] - x, shot.points[1] - y),
        flash=FlashLight.of(setup, shot.points),
        normal=maps.normal,
        surface=uniform.parameters(),
        limit=limit,
    )
    return target, uniform


def fitted(target: RingTarget, uniform: Uniform) -> tuple[float, float, float]:
    """Mean albedo, F0 and roughness."""
    levels, _ = fit_mean_parameters(target, ONE, torch.zeros(1, 5), PRIOR)
    found = (uniform.parameters() + SurfaceParameters.from_vector(levels[0])).reflectance()
    return float(found.diffuse.mean()), float(found.specular), float(found.roughness)


@pytest.mark.parametrize("roughness", [0.2, 0.35, 0.6])
def test_mean_parameters_are_recovered_under_relief(roughness: float) -> None:
    albedo, f0, found = fitted(*glossy(roughness, 0.2))
    assert albedo == pytest.approx(0.2, rel=0.1)
    assert f0 == pytest.approx(0.04, rel=0.15)
    assert found == pytest.approx(roughness, rel=0.1)


def test_a_clipped_core_is_a_lower_bound() -> None:
    target, uniform = glossy(0.25)
    assert 0.01 < float((~target.measured).float().mean()) < 0.1
    assert fitted(target, uniform)[2] == pytest.approx(0.25, rel=0.1)


@pytest.mark.parametrize("limit", [8.0, float("inf")])
def test_light_above_white_is_measured(limit: float) -> None:
    target, uniform = glossy(0.2, 2.0, limit)
    assert float(target.linear.max()) > 4.0
    albedo, f0, found = fitted(target, uniform)
    assert (albedo, f0) == (pytest.approx(0.2, rel=0.1), pytest.approx(0.04, rel=0.15))
    assert found == pytest.approx(0.2, rel=0.1)


def test_what_is_clipped_everywhere_is_raised_and_never_lowered() -> None:
    target, uniform = glossy(0.6, 0.2)
    nothing = replace(target, measured=torch.zeros_like(target.measured))
    bright = replace(nothing, surface=nothing.surface + _paler(1.0))
    levels, _ = fit_mean_parameters(bright, ONE, torch.zeros(1, 5), PRIOR)
    assert float(levels.abs().max()) < 0.05
    dark = replace(nothing, surface=nothing.surface + _paler(-2.0))
    levels, _ = fit_mean_parameters(dark, ONE, torch.zeros(1, 5), PRIOR)
    assert float(levels[0, :3].min()) > 0.5


def _paler(by: float) -> SurfaceParameters:
    return SurfaceParameters.from_vector(torch.tensor([by, by, by, 0.0, 0.0]))


def with_share(target: RingTarget, uniform: Uniform, share: float) -> RingTarget:
    """The target with a texture of which every ring has a diffuse share, relative to the last."""
    number = torch.tensor([0, 2, 4, 6])
    log_scatter = torch.linspace(math.log(share), 0.0, 4, dtype=torch.float64)
    free = torch.linalg.cholesky(0.01 * torch.eye(4, dtype=torch.float64) + 16.0)
    whitening = torch.linalg.inv(free)
    rings = DiffuseRings(log_scatter, number, torch.zeros(2, 4, 1, dtype=torch.float64), whitening)
    return replace(target, diffuse=rings)


def test_the_linearisation_is_the_derivative_of_the_residuals() -> None:
    target, uniform = glossy(0.4, 0.3)
    fit = _RingFit(with_share(target, uniform, 0.5), ONE, PRIOR)
    theta = torch.tensor([0.1, -0.1, 0.05, 0.02, 0.2])
    residual, columns = fit._linear(theta)
    assert torch.allclose(residual, fit.residuals(theta), atol=1e-4)
    for k, step in enumerate(0.01 * torch.eye(5)):
        slope = (fit.residuals(theta + step) - fit.residuals(theta - step)) / 0.02
        assert torch.allclose(-slope, columns[k], atol=0.03 * float(columns.abs().max()))


def test_texture_without_a_veil_takes_a_lobe_for_light() -> None:
    """The same profile of a highlight, whose texture keeps or loses its colour in the middle."""
    target, uniform = glossy(0.5, 0.3)

    def gloss(share: float) -> float:
        levels, _ = fit_mean_parameters(
            with_share(target, uniform, share), ONE, torch.zeros(1, 5), PRIOR
        )
        albedo, f0 = levels[0, :3].mean(), levels[0, 3]
        return float(f0 - albedo)

    assert gloss(1.0) < gloss(0.5)


def test_the_residual_of_the_diffuse_share_is_in_standard_deviations() -> None:
    target, uniform = glossy(0.5, 0.3)
    assert diffuse_share_residual(target) is None
    surface = replace(target, surface=uniform.parameters())
    off = {share: diffuse_share_residual(with_share(surface, uniform, share)) for share in (0.1, 1)}
    nearest = min(
        diffuse_share_residual(with_share(surface, uniform, share)) or 0.0
        for share in (0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
    )
    assert nearest < 1.0 < min(each or 0.0 for each in off.values())


# Metal's colour: told by what is seen of it, and no colour where nothing is metal.


METAL_GOLD = torch.tensor([1.0, 0.766, 0.336])[:, None, None]


def half_gold():
    """A shot whose right half is gold; (shot, its maps, its photograph, where metal is)."""
    shot = photographed(0.15, 0.1, width=96, height=64)
    metal = torch.zeros(1, 64, 96)
    metal[..., 48:] = 1.0
    maps = replace(
        shot.maps,
        diffuse=shot.maps.diffuse * (1.0 - metal) + 1e-3 * metal,
        specular=shot.maps.specular * (1.0 - metal) + 0.9 * METAL_GOLD * metal,
    )
    return shot, maps, render_flash(maps, shot.uniform.setup, shot.points), metal


def test_metal_is_seen_in_its_own_colour() -> None:
    _, _, linear, _ = half_gold()
    seen = seen_colour(linear, torch.ones(1, 64, 96))
    assert torch.allclose(seen.mean(0), torch.ones(64, 96), atol=1e-5)
    assert float((seen[:, :, 56:-4] / (METAL_GOLD / METAL_GOLD.mean()) - 1.0).abs().mean()) < 0.03


def test_clipped_texels_do_not_count_for_colour() -> None:
    _, _, linear, _ = half_gold()
    burnt = linear.clone()
    burnt[:, 30, 70] = 1e3
    measured = (burnt < 10.0).all(0, keepdim=True)
    whole = torch.ones_like(measured)
    assert torch.allclose(seen_colour(burnt, measured), seen_colour(linear, whole), atol=0.05)
    assert torch.allclose(seen_colour(linear, ~whole), torch.ones(3, 64, 96))


def test_dielectrics_and_doubtful_metal_stay_grey() -> None:
    assert not has_metal(torch.full((1, 8, 8), -2.0))
    assert has_metal(torch.linspace(-6.0, 6.0, 64).reshape(1, 8, 8))
    colour = seen_colour(torch.rand(3, 8, 8), torch.ones(1, 8, 8, dtype=torch.bool))
    assert torch.equal(specular_tint(torch.zeros(1, 8, 8), colour), torch.ones(3, 8, 8))


def test_refining_keeps_hue_and_finds_how_bright_metal_is() -> None:
    shot, maps, linear, metal = half_gold()
    measured = torch.ones(3, 64, 96, dtype=torch.bool)
    tint = specular_tint(metal, seen_colour(linear, metal))
    light = replace(shot.light, tint=tint)
    truth = light.residuals(maps)
    off = light.maps(truth).specular / maps.specular
    assert float(off.log().abs().mean()) < 0.02
    stripes = 0.3 * torch.sign(torch.sin(torch.arange(96) * 0.8))  # not slow: those are levels'
    guess = replace(
        truth,
        specular=truth.specular + stripes * metal,
        diffuse=truth.diffuse - 4.6 * metal,
    )
    doubt = torch.full((1, 64, 96), -1.0)
    errors = ExpectedErrors(doubt, doubt, doubt, doubt)
    found = light.maps(refine_albedo(guess, errors, linear, measured, light, metal=metal))
    lit = (slice(None), slice(16, 48), slice(60, 90))
    off = (found.specular / maps.specular).log()[lit].abs().mean()
    assert float(off) < 0.1
    assert float(found.diffuse[lit].mean()) < 0.02


# The flash's strength, which one photograph does not tell, by what materials are like.


def exemplar(albedo: float, specular: float, *, spread: float = 0.0) -> Exemplar:
    rng = np.random.default_rng(1)
    tone = np.exp(spread * rng.standard_normal((1, 32, 48))).astype(np.float32)
    one = np.ones((1, 32, 48), np.float32)
    diffuse = (albedo * tone * np.ones((3, 1, 1))).astype(np.float32).clip(0.0, 1.0)
    return Exemplar(
        diffuse, specular * one, 0.3 * one, 0.0 * one, np.ones((4, 32, 48), np.float32), 0.01
    )


DIELECTRIC = np.zeros((32, 48), np.float32)  # share of metal


def coarse_estimate(albedo: float, specular: float) -> tuple[float, float]:
    factor = most_probable_scale(exemplar(albedo, specular), DIELECTRIC)
    return albedo * factor, specular * factor


def test_black_leather_whose_gloss_is_three_times_its_albedo_is_black() -> None:
    albedo, specular = coarse_estimate(0.049, 0.132)
    assert specular == pytest.approx(0.04, rel=0.25) and albedo < 0.02


def test_black_gloss_is_a_dielectric_unless_its_class_is_metal() -> None:
    """Only the ratio of albedo to F0 is seen: whether it is metal is the coarse fit's to say."""
    assert coarse_estimate(0.003, 0.8)[1] < 0.1
    piece = exemplar(0.003, 0.8)
    metal = np.ones_like(piece.height[0])
    assert 0.8 * most_probable_scale(piece, metal) > 0.4


def coloured(f0: tuple[float, float, float], metal: np.ndarray, level: float) -> Exemplar:
    """Rust beside metal of a colour, under a flash told wrongly by `level`."""
    base = exemplar(0.1, 0.04)
    colour = np.array(f0, np.float32)[:, None, None]
    return Exemplar(
        (level * base.diffuse * (1.0 - metal)).astype(np.float32),
        (level * (0.04 * (1.0 - metal) + colour * metal)).astype(np.float32),
        base.roughness, base.height, base.confidence, 0.01,
    )  # fmt: skip


@pytest.mark.parametrize("name", ["gold", "copper", "brass"])
@pytest.mark.parametrize("level", [0.5, 0.8])
def test_metal_is_as_bright_as_pure_metals_of_its_colour(name: str, level: float) -> None:
    metal = np.ones((32, 48), np.float32)
    piece = coloured(METAL_F0[name], metal, level)
    assert most_probable_scale(piece, metal) * level == pytest.approx(1.0, rel=0.15)


def test_a_few_glints_do_not_keep_metal_dark() -> None:
    metal = np.ones((32, 48), np.float32)
    piece = coloured(METAL_F0["gold"], metal, 0.5)
    piece.specular[:, :2, :20] = 0.99  # 40 of 1536 texels
    assert most_probable_scale(piece, metal) * 0.5 == pytest.approx(1.0, rel=0.15)


def test_metal_and_dielectric_determine_the_flash_together() -> None:
    metal = np.zeros((32, 48), np.float32)
    metal[:, 24:] = 1.0
    piece = coloured(METAL_F0["steel"], metal, 0.2)
    assert most_probable_scale(piece, metal) * 0.2 == pytest.approx(1.0, rel=0.35)
    assert most_probable_scale(piece, metal[::2, ::2]) == pytest.approx(
        most_probable_scale(piece, metal), rel=0.05
    )


def test_a_metal_of_unknown_colour_has_the_prior_of_all() -> None:
    metal = np.ones((32, 48), np.float32)
    piece = coloured((0.05, 0.1, 0.8), metal, 1.0)
    assert 0.8 < most_probable_scale(piece, metal) < 2.5


def test_usual_materials_are_hardly_scaled() -> None:
    assert coarse_estimate(0.3, 0.04) == pytest.approx((0.3, 0.04), rel=0.1)


def test_bright_paper_stays_below_an_albedo_of_one() -> None:
    piece = exemplar(0.7, 0.02, spread=0.1)
    bright = scaled(piece, most_probable_scale(piece, DIELECTRIC))
    assert np.quantile(bright.diffuse, 0.99) < 1.0


@pytest.mark.parametrize("albedo", [1e-6, 0.02, 0.9])
@pytest.mark.parametrize("specular", [1e-6, 0.04, 0.95])
def test_every_exemplar_has_a_finite_scale(albedo: float, specular: float) -> None:
    factor = most_probable_scale(exemplar(albedo, specular), DIELECTRIC)
    assert math.isfinite(factor) and factor > 0.0


def test_the_picture_is_the_same_under_the_weaker_flash() -> None:
    piece, setup = exemplar(0.05, 0.12), FlashSetup(intensity=(3.0, 3.0, 3.0))

    def seen(one: Exemplar, under: FlashSetup) -> torch.Tensor:
        maps = MapSet.from_stacked(torch.from_numpy(one.stacked()), one.texel_size)
        return render_rectified(maps, under)

    before = seen(piece, setup)
    # Schlick's reflectance is F0 and a little that is not in proportion to it.
    assert torch.allclose(seen(scaled(piece, 0.3), setup.dimmed(0.3)), before, rtol=0.01)
