"""Noise and rounding of channels and sensors are believed little, and move nothing."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from photographed import Photographed, photographed

from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.estimate import estimate_exemplar, map_set_of
from matcap.capture.exemplar.network.network import ExpectedErrors, load_inverse
from matcap.capture.exemplar.observation import channel_noise, channel_weights, code_step
from matcap.capture.exemplar.refine import refine_albedo
from matcap.capture.progress import CaptureClock
from matcap.capture.rectified import Rectified, network_input
from matcap.files.srgb import srgb_decode
from matcap.flash.plane import plane_of

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
    assert noise[0] == pytest.approx(1.0, abs=1e-3)
    assert 0.02 < noise[1] < 0.05
    assert noise[2] < 0.015


def test_numbers_that_were_not_rounded_have_none():
    assert float(channel_noise(_plane((2e-4, 0.05, 0.5))).max()) == 0.0


def test_a_raws_noise_is_its_draws():
    draw = 0.01 * torch.randn(3, 96, 128, generator=torch.Generator().manual_seed(1))
    noise = channel_noise(_plane((0.1, 0.2, 0.5), draw)).mean((1, 2))
    assert noise.tolist() == pytest.approx([0.1, 0.05, 0.02], rel=0.1)


def test_channels_alike_weigh_alike_and_all_weights_add_up_to_one():
    even = channel_weights(torch.full((3, 4, 4), 0.02))
    torch.testing.assert_close(even, torch.full((3, 4, 4), 1.0 / 3.0))
    noise = torch.tensor([1.0, 0.01, 0.02])[:, None, None].expand(3, 4, 4)
    weights = channel_weights(noise)
    assert float(weights[0].max()) < 0.01
    torch.testing.assert_close(weights.sum(0), torch.ones(4, 4))


def test_a_dark_channel_of_a_saturated_jpeg_hardly_counts():
    # Yellow cloth 0263: codes 169, 115 and 20, whose fine detail is the same difference of codes.
    light = srgb_decode(np.array([169.0, 115.0, 20.0]) / 255.0)
    weights = channel_weights(channel_noise(_plane(tuple(light), developed=True))).mean((1, 2))
    assert float(weights[2]) < 0.1 and float(weights[1]) > 0.3


def test_a_channel_that_is_noise_moves_no_map():
    shot = photographed(0.1, 0.1, width=192, height=144)
    light = shot.light
    truth = light.residuals(shot.maps)
    errors = ExpectedErrors.from_stacked(torch.log(torch.full((4, 1, 1), 0.2)))
    draw = torch.Generator().manual_seed(6)
    linear = shot.linear.clone()
    linear[0] *= torch.randn(144, 192, generator=draw).exp()
    noise = torch.tensor([1.0, 0.01, 0.01])[:, None, None].expand(3, 144, 192)
    valid = torch.ones(144, 192, dtype=torch.bool)

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
    found = estimate_exemplar(rectified, load_inverse(), CaptureClock(None))
    return map_set_of(found.exemplar)


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_twice_the_noise_changes_the_maps_by_no_more_than_itself(noise: float) -> None:
    shot = photographed(0.15, 0.15, width=256, height=192)
    once, twice = _found(shot, noise), _found(shot, 2.0 * noise)

    def apart(one: torch.Tensor, other: torch.Tensor) -> float:
        return float((one - other).square().mean().sqrt()) / noise

    # A twentieth more: under the highlight, albedo is a part of what is seen only.
    assert 0.0 < apart(once.diffuse.log(), twice.diffuse.log()) < 1.05
    assert apart(once.specular.log(), twice.specular.log()) < 0.25
    assert apart(once.roughness, twice.roughness) < 0.25
    assert apart(once.normal, twice.normal) < 0.5
