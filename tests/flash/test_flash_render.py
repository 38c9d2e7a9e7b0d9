"""The flash renderer against closed forms."""

import math

import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.flash.geometry import FlashSetup
from matcap.flash.light import vignette
from matcap.flash.render import render_flash

CORNER = torch.tensor([[[0.0, 1.0, -1.0, 0.5]], [[0.0, 0.75, -0.75, 0.375]], [[0.0] * 4]])


@pytest.mark.parametrize("share", [0.4, -0.2, 0.0])
def test_vignetting_takes_light_from_the_corners_and_grows_with_the_radius_squared(share):
    """At the corner of a 4:3 picture the logarithm is the share itself, half way a quarter."""
    log = vignette(CORNER, FlashSetup(vignetting=share)).log()[0, 0]
    assert log.tolist() == pytest.approx([0.0, -share, -share, -share / 4.0], abs=1e-6)


@pytest.mark.parametrize("share", [0.8, -0.2])
def test_quartic_vignetting_is_the_share_at_a_corner_and_a_sixteenth_half_way(share):
    log = vignette(CORNER, FlashSetup(vignetting_quartic=share)).log()[0, 0]
    assert log.tolist() == pytest.approx([0.0, -share, -share, -share / 16.0], abs=1e-6)


def test_a_matt_plane_under_the_flash_is_lambert_and_the_inverse_square():
    setup = FlashSetup(fov=60.0, offset=(0.3, -0.1, 0.2), intensity=(2.0, 3.0, 5.0), vignetting=0.3)
    one = torch.ones(1, 1, 4)
    maps = MapSet(0.5 * one.expand(3, 1, 4), 0.0 * one, one, 0.0 * one, 1.0)
    light = torch.tensor(setup.offset) + torch.tensor([0.0, 0.0, setup.distance])
    away = light[:, None, None] - CORNER
    squared = away.square().sum(0)
    lambert = 0.5 / math.pi * away[2] / squared**1.5
    # Schlick's Fresnel reflects at grazing even where F0 is 0.
    picture = render_flash(maps, setup, CORNER) / vignette(CORNER, setup)
    for channel, intensity in enumerate(setup.intensity):
        assert torch.allclose(picture[channel], intensity * lambert, rtol=2e-3)
