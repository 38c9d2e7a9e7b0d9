"""Refinement by re-rendering."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import torch
from photographed import photographed

from matcap.brdf.parameters import SurfaceParameters
from matcap.capture.exemplar.network.network import ExpectedErrors
from matcap.capture.exemplar.refine import (
    flatten,
    radiance_residual,
    refine_albedo,
    with_photographed_mean,
)

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
    assert float(radiance_residual(refined, shot.linear, valid, light)[0].abs().median()) < 1e-3
    assert _largest(refined - truth) < 0.05


def test_a_flat_guess_is_moved_until_it_re_renders() -> None:
    shot, light, valid, truth = _setting()
    guess = _without_albedo_detail(truth)
    refined = refine_albedo(guess, ERRORS, shot.linear, valid, light)
    residual, slow = radiance_residual(refined, shot.linear, valid, light)
    assert float((residual - slow).abs().median()) < 0.01


def test_slow_drift_is_not_the_materials() -> None:
    shot, light, valid, truth = _setting()
    drift = torch.linspace(-0.15, 0.15, 192).exp()
    refined = refine_albedo(truth, ERRORS, shot.linear * drift, valid, light)
    assert float((refined - truth).diffuse.mean((0, 1)).diff().abs().mean()) < 1e-3
    _, slow = radiance_residual(refined, shot.linear * drift, valid, light)
    assert float(slow.abs().mean()) > 0.04


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
    unclipped = (shot.linear < clip).all(0)
    refined = refine_albedo(truth, ERRORS, clipped, unclipped, light)
    assert _largest(refined - truth) < 1e-3


def test_a_texel_whose_red_clips_is_told_by_the_others() -> None:
    shot, light, valid, truth = _setting()
    clipped, measured = shot.linear.clone(), torch.ones(3, 144, 192, dtype=torch.bool)
    clip = float(clipped[0].quantile(0.3))
    clipped[0] = clipped[0].clamp_max(clip)
    measured[0] = shot.linear[0] < clip

    def off(seen: torch.Tensor) -> float:
        refined = refine_albedo(_without_albedo_detail(truth), ERRORS, clipped, seen, light)
        result = measured[1:].all(0) & ~measured[0]
        apart = (refined - truth).diffuse[1:, result]
        return float((apart - apart.mean(1, keepdim=True)).abs().mean())

    assert off(measured) < 0.5 * off(measured.all(0))


def test_gloss_is_not_touched() -> None:
    """F0 and roughness are a class's: texels explain the photograph by albedo alone."""
    shot, light, valid, truth = _setting()
    found = refine_albedo(_without_albedo_detail(truth), ERRORS, shot.linear, valid, light)
    assert not found.specular.any() and not found.roughness.any()


def test_relief_is_not_touched() -> None:
    shot, light, valid, truth = _setting()
    guess = _without_albedo_detail(truth)
    refined = refine_albedo(guess, ERRORS, shot.linear, valid, light)
    assert float(refined.height.abs().max()) == 0.0


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
    assert float(_flattened(ramp)[:4, 24:-24, 32:-32].std()) < 0.35 * float(
        ramp[:4, 24:-24, 32:-32].std()
    )
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
    blotches = cv2.GaussianBlur(
        np.random.default_rng(3).standard_normal(texture.shape), (0, 0), 6.0
    )
    plain = torch.from_numpy(blotches.astype(np.float32)).expand(6, -1, -1).contiguous()
    before, kept = _flattened(plain), _flattened(plain, points=[mirror])
    assert float((kept - before)[:4].std()) < 0.1 * float(before[:4].std())
