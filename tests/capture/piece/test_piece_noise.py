"""The sensor's noise is not made larger on its way into the maps."""

from __future__ import annotations

import pytest
import torch
from photographed import Photographed, photographed

from matcap.brdf.maps import MapSet
from matcap.capture.detail import Rectified
from matcap.capture.piece.find import find_piece, piece_maps
from matcap.capture.piece.network.store import load_inverse
from matcap.capture.progress import CaptureClock
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.plane import plane_of


def _found(shot: Photographed, noise: float) -> MapSet:
    """Maps of one photograph with so much noise of log radiance, always the same draw."""
    draw = torch.Generator().manual_seed(4)
    photographed, another = (
        shot.linear * noise * torch.randn(shot.linear.shape, generator=draw) for _ in range(2)
    )
    linear = (shot.linear + photographed).clamp_min(0.0)
    plane = plane_of(linear, torch.ones(linear.shape[1:], dtype=torch.bool), another)
    uniform = shot.uniform
    coarse = CoarseFit(
        uniform.diffuse, uniform.specular, uniform.roughness, uniform.setup, residual=0.0
    )
    return piece_maps(
        find_piece(Rectified.of(plane), coarse, load_inverse(), CaptureClock(None)).exemplar
    )


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
