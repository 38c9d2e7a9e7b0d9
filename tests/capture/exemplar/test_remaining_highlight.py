"""Rings of albedo around the mirror point."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from photographed import photographed

from matcap.capture.exemplar.inpaint import inpainted, remaining_highlight
from matcap.capture.exemplar.network.network import load_inverse
from matcap.capture.exemplar.observation import Observation
from matcap.capture.exemplar.predict import exemplar_of, predict_maps
from matcap.capture.exemplar.refine import refine_maps
from matcap.flash.plane import plane_of

HEIGHT, WIDTH = 384, 512
MIRROR = (230.0, 180.0)
KNOWN = np.ones((HEIGHT, WIDTH), np.bool_)


def texture(seed: int, grain: float = 3.0, contrast: float = 0.3) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal((HEIGHT, WIDTH)).astype(np.float32)
    blurred = cv2.GaussianBlur(noise, (0, 0), grain)
    return np.exp(contrast * blurred / blurred.std() - 1.5)[None].repeat(3, 0).clip(0.0, 1.0)


def away(mirror: tuple[float, float]) -> np.ndarray:
    rows, columns = np.indices((HEIGHT, WIDTH))
    return np.hypot(columns - mirror[0], rows - mirror[1]).astype(np.float32)


@pytest.mark.parametrize("radius", [16.0, 40.0])
@pytest.mark.parametrize("gain", [0.5, 2.0])
def test_a_disc_is_found_whole_and_little_more(radius, gain):
    disc = away(MIRROR) < radius
    found = remaining_highlight(texture(0) * np.where(disc, gain, 1.0), KNOWN, away(MIRROR))
    assert found[disc].all()
    assert away(MIRROR)[found].max() < radius + 24.0


def test_a_ring_is_found_with_what_it_surrounds_if_it_is_near():
    for radius, near in ((12.0, True), (60.0, False)):
        ring = np.abs(away(MIRROR) - radius) < 6.0
        found = remaining_highlight(texture(1) * np.where(ring, 2.0, 1.0), KNOWN, away(MIRROR))
        assert found[away(MIRROR) < radius].all() if near else not found.any()


@pytest.mark.parametrize("grain", [1.0, 3.0, 12.0])
def test_a_texture_has_none(grain):
    rng = np.random.default_rng(5)
    hits = 0
    for seed in range(20):
        mirror = (float(rng.uniform(150, 360)), float(rng.uniform(120, 260)))
        hits += bool(remaining_highlight(texture(seed, grain), KNOWN, away(mirror)).any())
    assert hits <= 2


def test_a_spot_elsewhere_is_the_materials():
    spot = away((400.0, 100.0)) < 20.0
    found = remaining_highlight(texture(2) * np.where(spot, 2.0, 1.0), KNOWN, away(MIRROR))
    assert not found.any()


@pytest.mark.parametrize("off", [(30.0, 0.0), (-12.0, 24.0)])
def test_a_narrow_core_is_found_off_the_fitted_mirror_point(off):
    core = away((MIRROR[0] + off[0], MIRROR[1] + off[1])) < 10.0
    found = remaining_highlight(texture(8) * np.where(core, 2.5, 1.0), KNOWN, away(MIRROR))
    assert found[core].all()
    assert found.sum() < 9 * core.sum()


def test_a_spot_like_others_of_the_material_is_none():
    albedo = texture(9)
    for x in range(20, WIDTH, 64):
        for y in range(20, HEIGHT, 64):
            albedo[:, away((float(x), float(y))) < 10.0] = 0.9
    assert not remaining_highlight(albedo, KNOWN, away(MIRROR)).any()


def test_what_is_not_known_is_no_evidence():
    disc = away(MIRROR) < 16.0
    found = remaining_highlight(texture(3) * np.where(disc, 9.0, 1.0), ~disc, away(MIRROR))
    assert not found.any()


def test_a_halo_is_found_around_a_clipped_core():
    halo = (away(MIRROR) > 24.0) & (away(MIRROR) < 48.0)
    albedo = texture(6) * np.where(halo, 1.6, 1.0)
    albedo[:, away(MIRROR) < 28.0] = 0.5
    found = remaining_highlight(albedo, KNOWN, away(MIRROR))
    assert found[away(MIRROR) < 44.0].all()


def test_shading_across_the_picture_does_not_hide_a_halo():
    halo = (away(MIRROR) > 8.0) & (away(MIRROR) < 40.0)
    albedo = texture(7, contrast=0.1) * np.where(halo, 0.85, 1.0)
    shaded = albedo * np.exp(np.linspace(-0.6, 0.6, WIDTH, dtype=np.float32))
    assert remaining_highlight(shaded, KNOWN, away(MIRROR))[halo].all()


def test_a_mirror_point_outside_of_the_picture_is_none():
    assert not remaining_highlight(texture(4), KNOWN, away((-300.0, 900.0))).any()


def test_a_spot_in_albedo_is_inpainted():
    shot = photographed(0.15, 0.15, width=512, height=384)
    plane = plane_of(shot.linear, torch.ones(shot.linear.shape[1:], dtype=torch.bool))
    observed, prediction = predict_maps(Observation.of(plane, shot.uniform), load_inverse())
    prediction = refine_maps(observed, prediction)
    residuals = prediction.residuals
    disc = (observed.from_mirror_point / plane.texel_size).numpy() < 20.0
    white = residuals.diffuse + 0.8 * torch.from_numpy(disc)
    spotted = replace(prediction, residuals=replace(residuals, diffuse=white))
    plain, found = (
        inpainted(exemplar_of(observed, each), observed).diffuse for each in (prediction, spotted)
    )
    inside = np.log(found[:, disc]).mean() - np.log(found[:, ~disc]).mean()
    before = np.log(plain[:, disc]).mean() - np.log(plain[:, ~disc]).mean()
    assert abs(inside - before) < 0.3
