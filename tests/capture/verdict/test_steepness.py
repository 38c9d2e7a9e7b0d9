"""Steepness: slow relief that a decoder has and its exemplar has not."""

import math
from dataclasses import replace

import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.capture.verdict.steepness import steepness

TEXEL = 0.002
ALONG = torch.arange(384.0)


def relief(slow, fine, phase=0.0):
    """Maps with waves of 32 and of 3 texels, of these amplitudes in texels, in both directions."""
    along = slow * torch.sin(math.tau * ALONG / 32.0 + phase) + fine * torch.sin(ALONG * 2.1)
    height = TEXEL * (along[None, :, None] + along[None, None, :])
    return MapSet(*(torch.full((count, 384, 384), 0.5) for count in (3, 1, 1)), height, TEXEL)


def test_it_is_of_slow_waves_however_fine_grain_is():
    assert steepness(relief(3.0, 0.1, 1.0), relief(1.0, 0.1)) == pytest.approx(3.0, rel=0.05)
    assert steepness(relief(1.0, 0.1), relief(3.0, 0.1)) == pytest.approx(1.0 / 3.0, rel=0.05)
    assert steepness(relief(1.0, 0.02), relief(1.0, 0.1)) == pytest.approx(1.0, rel=0.02)


def test_what_no_eye_sees_is_no_relief_and_relief_of_stains_is():
    assert steepness(relief(0.01, 0.1), relief(0.0, 0.1)) < 1.1
    assert steepness(relief(0.2, 0.1), relief(0.0, 0.0)) > 3.0


def test_without_any_relief_and_in_small_maps_it_is_not_known():
    flat = relief(0.0, 0.0)
    assert math.isnan(steepness(flat, flat))
    small = replace(flat, **{
        name: getattr(relief(1.0, 0.1), name)[:, :64, :64]
        for name in ("diffuse", "specular", "roughness", "height")
    })  # fmt: skip
    assert math.isnan(steepness(small, small))
