"""Channels that are mostly noise or rounding are believed little, and move nothing."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from photographed import photographed

from matcap.capture.piece.network.network import ExpectedErrors
from matcap.capture.piece.noise import channel_noise, channel_weights, code_step
from matcap.capture.piece.refine import PieceLight, refine
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


def test_a_channel_that_is_noise_moves_no_map():
    shot = photographed(0.1, 0.1, width=192, height=144)
    light = PieceLight.of(shot.uniform, shot.points)
    truth = light.departures(shot.maps)
    errors = ExpectedErrors.from_stacked(torch.log(torch.full((4, 1, 1), 0.2)))
    draw = torch.Generator().manual_seed(6)
    linear = shot.linear.clone()
    linear[0] *= torch.randn(144, 192, generator=draw).exp()
    noise = torch.tensor([1.0, 0.01, 0.01])[:, None, None].expand(3, 144, 192)
    valid = torch.ones(144, 192, dtype=torch.bool)

    def moved(said):
        found = refine(truth, errors, linear, valid, light, noise=said).departures
        return float((found - truth).diffuse[1:].square().mean().sqrt())

    assert moved(noise) < 0.2 * moved(0.01)
