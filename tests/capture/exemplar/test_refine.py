"""Refinement of maps, glints, and noise by channel."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from photographed import SETUP, Photographed, even, in_8_bits, photographed, whole_plane

from matcap.brdf.cook_torrance import SurfaceParameters
from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.estimate import estimate_exemplar
from matcap.capture.exemplar.glints import without_glints
from matcap.capture.exemplar.network.network import ExpectedErrors, load_inverse
from matcap.capture.exemplar.predict import map_set_of
from matcap.capture.exemplar.refine import (
    evened_albedo,
    flatten,
    radiance_residual,
    refine_albedo,
    refitted_to_highlight,
    scaled_by_glints,
    with_photographed_mean,
)
from matcap.capture.exemplar.relief_spectrum import ReliefSpectrum, slope_spectrum
from matcap.capture.rectified import (
    Observation,
    Rectified,
    channel_noise,
    channel_weights,
    code_step,
    network_input,
)
from matcap.capture.settings import CaptureClock
from matcap.example.exemplar import Exemplar
from matcap.files.color import srgb_decode
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.light import render_flash
from matcap.flash.rectify import plane_of
from matcap.photo.photo import ToneCurve

# Refinement by re-rendering.


ERRORS = ExpectedErrors.from_stacked(torch.log(torch.tensor([0.2, 0.1, 0.1, 0.1]))[:, None, None])


def _without_albedo_detail(like: SurfaceParameters) -> SurfaceParameters:
    return like - like


def _largest(parameters: SurfaceParameters) -> float:
    return float(parameters.stacked().abs().max())


def _paler(parameters: SurfaceParameters, by) -> SurfaceParameters:
    return replace(parameters, diffuse=parameters.diffuse + by)


def _setting(contrast: float = 0.1):
    shot = photographed(0.1, contrast, width=192, height=144)
    light = shot.light
    return shot, light, torch.ones(144, 192, dtype=torch.bool), light.residuals(shot.maps)


def test_the_truth_is_left_alone() -> None:
    shot, light, valid, truth = _setting()
    refined = refine_albedo(truth, ERRORS, shot.linear, valid, light)
    assert float(radiance_residual(refined, shot.linear, valid, light).abs().median()) < 1e-3
    assert _largest(refined - truth) < 0.05


def test_a_flat_guess_is_moved_by_albedo_alone_until_it_re_renders() -> None:
    """F0 and roughness are a class's."""
    shot, light, valid, truth = _setting()
    refined = refine_albedo(_without_albedo_detail(truth), ERRORS, shot.linear, valid, light)
    residual = radiance_residual(refined, shot.linear, valid, light)[0].numpy()
    assert np.median(np.abs(residual - cv2.GaussianBlur(residual, (0, 0), 16.0))) < 0.01
    assert not any(one.any() for one in (refined.specular, refined.roughness, refined.height))


def test_slow_drift_is_not_the_materials() -> None:
    shot, light, valid, truth = _setting()
    drift = torch.linspace(-0.15, 0.15, 192).exp()
    refined = refine_albedo(truth, ERRORS, shot.linear * drift, valid, light)
    assert float((refined - truth).diffuse.mean((0, 1)).diff().abs().mean()) < 1e-3


def test_the_mean_radiance_is_the_photographs_in_every_channel() -> None:
    """Whatever the texture's contrast; a few clipped texels do not count."""
    shot, light, valid, truth = _setting(contrast=0.5)
    off = _paler(truth, torch.tensor([-0.4, -0.3, 0.1])[:, None, None])
    clipped = shot.linear.clone()
    clipped[:, :20] = 9.0
    valid[:20] = False
    found = with_photographed_mean(off, clipped, valid.expand(3, -1, -1), light)
    assert _largest(found - truth) < 0.01
    # Of half the contrast the mean log radiance differs, the mean radiance does not.
    mean = truth.diffuse.mean((1, 2), keepdim=True)
    fainter = replace(truth, diffuse=mean + 0.5 * (truth.diffuse - mean))
    found = with_photographed_mean(fainter, shot.linear, valid.expand(3, -1, -1), light)
    ratio = light.rendered(light.maps(found))[0].exp().mean((1, 2)) / shot.linear.mean((1, 2))
    assert float(ratio.log().abs().max()) < 0.02


def test_the_mean_of_a_metals_radiance_is_its_f0() -> None:
    shot, light, valid, truth = _setting()
    metal = replace(truth, diffuse=truth.diffuse - 9.0, specular=truth.specular + 2.0)
    linear = light.rendered(light.maps(metal))[0].exp()
    off = replace(metal, specular=metal.specular - 0.3)
    one = torch.ones_like(metal.specular)
    found = with_photographed_mean(off, linear, valid.expand(3, -1, -1), light, one)
    assert float((found.specular - metal.specular).abs().max()) < 0.01
    assert torch.equal(found.diffuse, off.diffuse)


def test_clipped_texels_are_lower_bounds() -> None:
    """Brighter than the clip level is as good as at it; darker is not."""
    shot, light, valid, truth = _setting()
    clip = float(shot.linear.quantile(0.3))
    clipped = shot.linear.clamp_max(clip)
    refined = refine_albedo(truth, ERRORS, clipped, (shot.linear < clip).all(0), light)
    assert _largest(refined - truth) < 1e-3


def test_a_texel_whose_red_clips_is_told_by_the_others() -> None:
    shot, light, valid, truth = _setting()
    clipped, measured = shot.linear.clone(), torch.ones(3, 144, 192, dtype=torch.bool)
    clip = float(clipped[0].quantile(0.3))
    clipped[0] = clipped[0].clamp_max(clip)
    measured[0] = shot.linear[0] < clip

    def off(seen: torch.Tensor) -> float:
        refined = refine_albedo(_without_albedo_detail(truth), ERRORS, clipped, seen, light)
        error = (refined - truth).diffuse[1:, measured[1:].all(0) & ~measured[0]]
        return float((error - error.mean(1, keepdim=True)).abs().mean())

    assert off(measured) < 0.5 * off(measured.all(0))


def _log_radiance(residuals, light):
    maps = light.maps(residuals)
    return light.flash.onto(maps.normal).log_radiance(maps)[0]


def test_what_is_clipped_must_be_as_bright_as_the_clip_level() -> None:
    shot, light, _, truth = _setting()
    clip = float(shot.linear.quantile(0.7))
    valid = (shot.linear < clip).all(0)
    guess = _paler(truth, -0.6 * (~valid))
    refined = refine_albedo(guess, ERRORS, shot.linear.clamp_max(clip), valid, light)
    too_dark = [
        (shot.linear.clamp_max(clip).log() - _log_radiance(o, light)).clamp_min(0.0)[:, ~valid]
        for o in (guess, refined)
    ]
    assert float(too_dark[1].mean()) < 0.4 * float(too_dark[0].mean())


def _flattened(stacked, confidence=None, points=()):
    shape = stacked.shape[-2:]
    trusted = np.ones(shape, np.float32) if confidence is None else confidence
    rows, columns = np.indices(shape).astype(np.float32)
    distances = [np.hypot(columns - x, rows - y) for x, y in points]
    return flatten(
        SurfaceParameters.from_stacked(stacked), trusted, distances, max(stacked.shape)
    ).stacked()


def test_the_mean_of_albedo_is_the_one_where_it_is_trusted() -> None:
    halves = torch.zeros(6, 96, 128)
    halves[:3, :, 64:] = 1.0
    left = np.zeros((96, 128), np.float32)
    left[:, :64] = 1.0
    assert _flattened(halves, left)[:3].mean((1, 2)).abs().max() < 0.1


def test_nothing_of_a_stationary_sample_follows_the_highlight_or_drifts() -> None:
    y, x = np.mgrid[-1.0:1.0:96j, -1.33:1.33:128j]
    glare = np.exp(-(x**2 + y**2) / 0.02).astype(np.float32)
    spot = torch.zeros(6, 96, 128)
    spot[:4] = torch.from_numpy(glare)
    assert float(_flattened(spot, points=[(63.5, 47.5)])[:4].std()) < 0.2 * float(spot[:4].std())
    ramp = torch.from_numpy(x.astype(np.float32)).expand(6, 96, 128).contiguous()
    left, before = (float(one[:4, 24:-24, 32:-32].std()) for one in (_flattened(ramp), ramp))
    assert left < 0.35 * before
    assert torch.equal(_flattened(ramp)[5], ramp[5])  # relief is left to equalise()


def test_rings_around_the_light_are_no_material_and_a_texture_is() -> None:
    rows, columns = np.indices((192, 256))
    mirror = (110.0, 90.0)
    distance = np.hypot(columns - mirror[0], rows - mirror[1])
    texture = 0.3 * np.random.default_rng(3).standard_normal(distance.shape)
    texture = cv2.GaussianBlur(texture, (0, 0), 2.0)
    halo = 0.2 * np.exp(-(((distance - 40.0) / 8.0) ** 2))
    plain, ringed = (
        torch.from_numpy(p.astype(np.float32)).expand(6, -1, -1).contiguous()
        for p in (texture, texture + halo)
    )
    before, after = _flattened(plain), _flattened(ringed, points=[mirror])
    ring = torch.from_numpy(np.abs(distance - 40.0) < 4.0)
    assert float((after - before)[:4, ring].abs().mean()) < 0.2 * float(halo[ring.numpy()].mean())
    noise = np.random.default_rng(3).standard_normal(texture.shape)
    blotches = cv2.GaussianBlur(noise, (0, 0), 6.0)
    plain = torch.from_numpy(blotches.astype(np.float32)).expand(6, -1, -1).contiguous()
    before, kept = _flattened(plain), _flattened(plain, points=[mirror])
    assert float((kept - before)[:4].std()) < 0.1 * float(before[:4].std())


# Relief is scaled to the contrast of glints.


HEIGHT, WIDTH = 192, 256


def scene(albedo: float, roughness: float):
    """Photograph, its light and true residuals of an even surface with relief."""
    shot = even(photographed(0.06, 0.0, width=WIDTH, height=HEIGHT), albedo, roughness)
    return (
        shot.linear / float(shot.linear.quantile(0.99)),
        shot.light,
        shot.light.residuals(shot.maps),
    )


def factor(albedo: float, roughness: float, strength: float) -> float:
    """What relief is scaled by where it was predicted `strength` times as strong as it is."""
    linear, light, truth = scene(albedo, roughness)
    guess = replace(truth, height=strength * truth.height)
    found = scaled_by_glints(guess, linear, linear < 1.0, light, torch.full_like(linear, 1e-3))
    return float(found.height.std() / guess.height.std())


@pytest.mark.parametrize("strength", [0.3, 1.0, 1.5])
def test_relief_gets_the_strength_of_the_glints(strength: float) -> None:
    assert factor(0.003, 0.5, strength) == pytest.approx(1.0 / strength, rel=0.25)


def test_texture_that_differs_in_the_highlight_is_no_steep_relief() -> None:
    """The middle of a worn board is scratched; its relief is as steep as the whole picture says."""
    linear, light, truth = scene(0.02, 0.5)
    guess = replace(truth, height=0.5 * truth.height)
    scratched = linear.mean(0) > linear.mean(0).quantile(0.9)
    noise = torch.from_numpy(np.random.default_rng(2).normal(size=(HEIGHT, WIDTH))).float()
    worn = linear * torch.where(scratched, 1.5 * noise, 0.0).exp()
    slopes = np.square(slope_spectrum(truth.height[0].numpy()))
    error = np.broadcast_to(0.3 / np.sqrt(6.0) * slopes.sum(1, keepdims=True), slopes.shape)
    right = ReliefSpectrum(0.0 * slopes, np.sqrt(slopes), error)
    told = guess, worn, worn < 9.0, light, torch.full_like(linear, 1e-3)
    alone, measured = (scaled_by_glints(*told, spectrum) for spectrum in (None, right))
    steep, wanted, true = (one.height.diff(dim=2).std() for one in (alone, measured, truth))
    assert steep > 1.25 * wanted and float(wanted / true) == pytest.approx(1.0, rel=0.25)


def test_an_octave_below_the_noise_does_not_flatten_the_others() -> None:
    """Where stains differ by place, glints say little of relief, nothing of its finest octave."""
    _, light, truth = scene(0.1, 0.5)
    random = np.random.default_rng(1)
    stains = cv2.GaussianBlur(random.normal(size=(HEIGHT, WIDTH)), (0, 0), 3.0)
    stains = 0.05 * stains / stains.std() * np.linspace(0.0, 2.0, WIDTH)
    smooth = 0.3 * cv2.GaussianBlur(truth.height[0].numpy(), (0, 0), 2.0)
    even = truth.diffuse
    stained = even + torch.from_numpy(stains).float()
    truth = replace(truth, diffuse=stained, height=torch.from_numpy(smooth)[None])
    linear = light.rendered(light.maps(truth))[0].exp()
    noisy = linear * (0.03 * torch.from_numpy(random.normal(size=linear.shape)).float()).exp()
    guess = replace(truth, diffuse=even)
    scaled = scaled_by_glints(guess, noisy, noisy < 9.0, light, torch.full_like(linear, 0.045))
    slope, true = (each.height.diff(dim=2).std() for each in (scaled, truth))
    assert float(slope / true) == pytest.approx(1.0, rel=0.3)


def test_a_matte_photograph_leaves_relief_alone() -> None:
    assert factor(0.5, 0.9, 0.3) == 1.0


def test_a_pattern_under_a_glaze_is_no_relief() -> None:
    _, light, truth = scene(0.1, 0.3)
    noise = np.random.default_rng(1).normal(size=(HEIGHT, WIDTH)).astype(np.float32)
    drawing = torch.from_numpy(cv2.GaussianBlur(noise, (0, 0), 3.0))[None]
    drawing = drawing / drawing.std()
    flat = replace(truth, diffuse=truth.diffuse + drawing, height=0.0 * truth.height)
    maps = light.maps(flat)
    linear = light.flash.onto(maps.normal).log_radiance(maps)[0].exp()
    linear = linear / float(linear.quantile(0.99))
    guess = replace(truth, height=0.03 * truth.height)  # and an albedo that is even
    scaled = scaled_by_glints(guess, linear, linear < 1.0, light, 1e-3 * torch.ones_like(linear))
    slope, before = (each.height.diff(dim=2).std() for each in (scaled, guess))
    assert float(slope) < 1.3 * float(before)


# Noise and rounding of channels and sensors are believed little, and move nothing.


WHOLE = torch.ones(96, 128, dtype=torch.bool)


def _plane(values, noise=None, *, developed=False):
    linear = torch.tensor(values)[:, None, None].expand(3, 96, 128).clone()
    plane = plane_of(linear, WHOLE, noise)
    return type(plane)(plane.linear, plane.valid, plane.noise, plane.encoding, developed=developed)


@pytest.mark.parametrize("code", [1.0, 5.0, 40.0, 128.0, 250.0])
def test_a_code_is_worth_what_the_curve_of_srgb_rises_by(code):
    encoded = np.array([code - 0.5, code + 0.5]) / 255.0
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    middle = np.array([linear.mean()], np.float32)
    assert code_step(middle)[0] == pytest.approx(linear[1] - linear[0], rel=0.02)


def test_a_channel_of_one_code_is_noise_and_a_bright_one_is_not():
    noise = channel_noise(_plane((2e-4, 0.05, 0.5), developed=True)).mean((1, 2))
    assert noise[0] == pytest.approx(1.0, abs=1e-3) and 0.02 < noise[1] < 0.05 and noise[2] < 0.015


@pytest.mark.parametrize("code", [3.0, 40.0, 220.0])
def test_a_code_is_worth_what_the_undone_tone_curve_makes_of_it(code):
    tone = ToneCurve(1.3, 0.5)
    log = np.log(tone.linear(srgb_decode(np.array([code - 0.5, code, code + 0.5]) / 255.0)))
    noise = channel_noise(_plane((float(np.exp(log[1])),) * 3, developed=True), tone)
    assert float(noise.mean()) == pytest.approx(log[2] - log[0], rel=0.1)


def test_numbers_that_were_not_rounded_have_none():
    assert float(channel_noise(_plane((2e-4, 0.05, 0.5))).max()) == 0.0


def test_a_raws_noise_is_its_draws():
    draw = 0.01 * torch.randn(3, 96, 128, generator=torch.Generator().manual_seed(1))
    noise = channel_noise(_plane((0.1, 0.2, 0.5), draw)).mean((1, 2))
    assert noise.tolist() == pytest.approx([0.1, 0.05, 0.02], rel=0.1)


def test_channels_alike_weigh_alike_and_all_weights_add_up_to_one():
    even = channel_weights(torch.full((3, 4, 4), 0.02))
    torch.testing.assert_close(even, torch.full((3, 4, 4), 1.0 / 3.0))
    weights = channel_weights(torch.tensor([1.0, 0.01, 0.02])[:, None, None].expand(3, 4, 4))
    assert float(weights[0].max()) < 0.01
    torch.testing.assert_close(weights.sum(0), torch.ones(4, 4))


def test_a_dark_channel_of_a_saturated_jpeg_hardly_counts():
    # Yellow cloth 0263: codes 169, 115 and 20, whose fine detail is the same difference of codes.
    light = srgb_decode(np.array([169.0, 115.0, 20.0]) / 255.0)
    weights = channel_weights(channel_noise(_plane(tuple(light), developed=True))).mean((1, 2))
    assert float(weights[2]) < 0.1 and float(weights[1]) > 0.3


def test_a_channel_that_is_noise_moves_no_map():
    shot, light, valid, truth = _setting()
    errors = ExpectedErrors.from_stacked(torch.log(torch.full((4, 1, 1), 0.2)))
    draw = torch.Generator().manual_seed(6)
    linear = shot.linear.clone()
    linear[0] *= torch.randn(144, 192, generator=draw).exp()
    noise = torch.tensor([1.0, 0.01, 0.01])[:, None, None].expand(3, 144, 192)

    def moved(said):
        found = refine_albedo(truth, errors, linear, valid, light, noise=said)
        return float((found - truth).diffuse[1:].square().mean().sqrt())

    assert moved(noise) < 0.2 * moved(0.01)


def _found(shot: Photographed, noise: float) -> MapSet:
    """Maps of one photograph with so much noise of log radiance, always the same draw."""
    draw = torch.Generator().manual_seed(4)
    photographed, another = (
        shot.linear * noise * torch.randn(shot.linear.shape, generator=draw) for _ in range(2)
    )
    linear = (shot.linear + photographed).clamp_min(0.0)
    plane = plane_of(linear, torch.ones(linear.shape[1:], dtype=torch.bool), another)
    rectified = Rectified(None, shot.uniform, plane, (), network_input(plane))
    return map_set_of(estimate_exemplar(rectified, load_inverse(), CaptureClock(None)).exemplar)


def test_twice_the_noise_changes_the_maps_by_no_more_than_itself() -> None:
    noise = 0.02
    shot = photographed(0.15, 0.15, width=256, height=192)
    once, twice = _found(shot, noise), _found(shot, 2.0 * noise)

    def apart(one: torch.Tensor, other: torch.Tensor) -> float:
        return float((one - other).square().mean().sqrt()) / noise

    # A twentieth more: under the highlight, albedo is a part of what is seen only.
    assert 0.0 < apart(once.diffuse.log(), twice.diffuse.log()) < 1.05
    assert apart(once.specular.log(), twice.specular.log()) < 0.25
    assert apart(once.roughness, twice.roughness) < 0.25 and apart(once.normal, twice.normal) < 0.5


@pytest.mark.parametrize("factor", [0.75, 1.0, 1.4])
def test_gloss_is_fitted_to_the_highlight_with_the_finished_relief(factor: float) -> None:
    shot = photographed(0.05, 0.1, width=384, height=288)
    true = replace(shot.maps, roughness=torch.full_like(shot.maps.roughness, 0.3))
    linear = render_flash(true, shot.uniform.setup, shot.points)
    plane = plane_of(linear, torch.ones(linear.shape[1:], dtype=torch.bool), headroom=math.inf)
    observed = Observation.of(plane, replace(shot.uniform, roughness=0.3))
    wrong = replace(true, roughness=true.roughness * factor, height=true.height.roll(50, 1))
    exemplar = Exemplar.certain(wrong.stacked().numpy(), wrong.texel_size)
    fitted = refitted_to_highlight(exemplar, observed, np.zeros(linear.shape[1:], np.float32))
    assert float(fitted.roughness.mean()) == pytest.approx(0.3, rel=0.1)
    assert float(fitted.specular.mean()) == pytest.approx(0.04, rel=0.15)
    assert np.allclose(fitted.diffuse, exemplar.diffuse, rtol=0.1)
    clipping = Observation.of(plane_of(linear, plane.valid), shot.uniform)
    assert refitted_to_highlight(exemplar, clipping, np.zeros_like(wrong.height[0])) is exemplar


def test_glints_of_black_gloss_are_no_albedo():
    """Of black gloss, log albedo varies no more in the lobe than beside it; a pattern that varies
    alike everywhere, such as fibres, stays, and so does all of a matte sample."""
    drawn = np.random.default_rng(1).normal(0.5, 0.2, (3, 384, 512)).astype(np.float32)
    for albedo, glints in ((0.0003, 1.0), (0.0003, 4.0), (0.3, 4.0)):
        shot, observed = in_8_bits(albedo, 4.0)
        lobe = observed.specular_fraction > np.quantile(observed.specular_fraction, 0.5)
        diffuse = torch.from_numpy(np.where(lobe, 0.5 + glints * (drawn - 0.5), drawn))
        before = replace(observed.light.residuals(shot.maps), diffuse=diffuse)
        after = evened_albedo(observed, before).diffuse
        if albedo == 0.3:
            assert torch.equal(after, diffuse)
            continue
        used = observed.plane.valid.numpy()
        assert float(after[:, lobe & used].std()) == pytest.approx(0.2, rel=0.15)
        assert float(after[:, ~lobe & used].std()) == pytest.approx(0.2, rel=0.1)
        assert float(after[:, used].mean()) == pytest.approx(0.5, abs=0.03)


def test_chroma_of_dim_corners_is_no_stronger_than_elsewhere():
    """Chroma three times as strong in dim light is evened to 1.25 times; lightness stays."""
    shot, observed = in_8_bits(0.3, 4.0)
    light = observed.light.flash.power.mean(0).numpy()
    dim = light < np.quantile(light, 0.1)
    noise = np.random.default_rng(1).normal(0.0, 0.2, (3, 384, 512)).astype(np.float32)
    grey = noise.mean(0)
    diffuse = torch.from_numpy(grey + (noise - grey) * np.where(dim, 3.0, 1.0).astype(np.float32))
    before = replace(observed.light.residuals(shot.maps), diffuse=diffuse)
    after = evened_albedo(observed, before).diffuse.numpy()
    strong, usual = ((after - after.mean(0))[:, where].std() for where in (dim, ~dim))
    assert strong / usual == pytest.approx(1.25, rel=0.15)
    assert np.allclose(after.mean(0), grey, atol=1e-3)


def test_a_stain_in_a_corner_leaves_albedo_as_it_is():
    shot, observed = in_8_bits(0.3, 4.0)
    noise = np.random.default_rng(1).normal(0.0, 0.15, (1, 384, 512)).astype(np.float32)
    stained = np.repeat(noise, 3, axis=0)
    stained[:, 10:74, 10:74] -= 1.2
    diffuse = torch.from_numpy(stained)
    before = replace(observed.light.residuals(shot.maps), diffuse=diffuse)
    after = evened_albedo(observed, before).diffuse.numpy()
    assert after[:, 10:74, 10:74].mean() == pytest.approx(-1.2, rel=0.15)
    assert after[0, -64:, -64:].std() == pytest.approx(noise[0, -64:, -64:].std(), rel=0.15)


# White glints of coloured materials are no albedo.


WOOD = (0.2, 0.08, 0.03)


def _wood(albedo: tuple[float, float, float] = WOOD) -> tuple[torch.Tensor, CoarseFit]:
    """A photograph of flat wood, its grain a log contrast of 0.2, and what it was fitted by."""
    shot = photographed(0.0001, 0.2)
    uniform = CoarseFit(albedo, 0.04, 0.4, SETUP, residual=0.0)
    tone = shot.maps.diffuse[:1] / shot.uniform.diffuse[0]
    maps = replace(
        shot.maps,
        diffuse=torch.tensor(albedo)[:, None, None] * tone,
        roughness=torch.full_like(shot.maps.roughness, 0.4),
    )
    return render_flash(maps, SETUP, shot.points), uniform


def _dashes(light: torch.Tensor) -> torch.Tensor:
    """(H, W) bool: dashes along a streak through the highlight, 6 % of it."""
    where = torch.zeros(light.shape[-2:], dtype=torch.bool)
    for row in range(20, 364, 6):
        column = 240 + (7 * row) % 50
        where[row : row + 2, column : column + 10] = True
    return where


def test_glints_along_a_streak_are_taken_off_and_nothing_else() -> None:
    light, uniform = _wood()
    where = _dashes(light)
    bright = light + where * light.mean()
    found = without_glints(whole_plane(bright), uniform).linear
    left = (found - light)[:, where].abs().mean() / (bright - light)[:, where].abs().mean()
    assert left < 0.5
    assert torch.equal(found[:, ~where], light[:, ~where])


def test_a_white_mark_of_wood_stays() -> None:
    light, uniform = _wood()
    where = torch.zeros(light.shape[-2:], dtype=torch.bool)
    where[300:304, 60:66] = True
    marked = torch.where(where, 5.0 * light[2:].expand_as(light), light)
    assert torch.equal(without_glints(whole_plane(marked), uniform).linear, marked)


@pytest.mark.parametrize("conductor", [False, True])
def test_grey_and_metal_are_unchanged(conductor: bool) -> None:
    light, uniform = _wood(WOOD if conductor else (0.1, 0.1, 0.09))
    plane = whole_plane(light + _dashes(light) * light.mean())
    assert without_glints(plane, replace(uniform, conductor=conductor)) is plane
    assert without_glints(plane, _wood()[1], metal=True) is plane
