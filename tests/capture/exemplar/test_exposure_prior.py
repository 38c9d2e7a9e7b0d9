"""The flash's strength, which one photograph does not tell, by what materials are like."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.brdf.metals import METAL_F0
from matcap.capture.exemplar.exposure_prior import most_probable_scale, scaled
from matcap.example.exemplar import Exemplar
from matcap.flash.geometry import FlashSetup
from matcap.flash.render import render_rectified


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
def test_metal_is_as_bright_as_its_hue_says(name: str, level: float) -> None:
    metal = np.ones((32, 48), np.float32)
    piece = coloured(METAL_F0[name], metal, level)
    assert most_probable_scale(piece, metal) * level == pytest.approx(1.0, rel=0.15)


def test_a_few_glints_do_not_keep_metal_dark() -> None:
    metal = np.ones((32, 48), np.float32)
    piece = coloured(METAL_F0["gold"], metal, 0.5)
    piece.specular[:, :2, :20] = 0.99  # 40 of 1536 texels
    assert most_probable_scale(piece, metal) * 0.5 == pytest.approx(1.0, rel=0.15)


def test_metal_and_what_is_none_tell_the_flash_together() -> None:
    metal = np.zeros((32, 48), np.float32)
    metal[:, 24:] = 1.0
    piece = coloured(METAL_F0["steel"], metal, 0.2)
    assert most_probable_scale(piece, metal) * 0.2 == pytest.approx(1.0, rel=0.35)
    assert most_probable_scale(piece, metal[::2, ::2]) == pytest.approx(
        most_probable_scale(piece, metal), rel=0.05
    )


def test_a_metal_of_no_known_hue_is_as_bright_as_any() -> None:
    metal = np.ones((32, 48), np.float32)
    piece = coloured((0.05, 0.1, 0.8), metal, 1.0)
    assert 0.8 < most_probable_scale(piece, metal) < 2.5


def test_what_is_usual_hardly_moves() -> None:
    assert coarse_estimate(0.3, 0.04) == pytest.approx((0.3, 0.04), rel=0.1)


def test_bright_paper_stays_within_the_light_there_is() -> None:
    piece = exemplar(0.7, 0.02, spread=0.1)
    bright = scaled(piece, most_probable_scale(piece, DIELECTRIC))
    assert np.quantile(bright.diffuse, 0.99) < 1.0


@pytest.mark.parametrize("albedo", [1e-6, 0.02, 0.9])
@pytest.mark.parametrize("specular", [1e-6, 0.04, 0.95])
def test_any_piece_has_a_finite_scale(albedo: float, specular: float) -> None:
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
