"""Maps against their own truth."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.flash.geometry import FlashSetup
from matcap.lab.bench.aligned import RINGS, aligned_errors
from matcap.lab.measures.lights import bench_scene

SETUP = FlashSetup(fov=60.0, offset=(0.1, 0.0, 0.0), intensity=(8.0,) * 3)


def _maps() -> MapSet:
    generator = torch.Generator().manual_seed(1)
    draw = lambda channels: torch.rand(channels, 48, 64, generator=generator)  # noqa: E731
    return MapSet(0.1 + 0.4 * draw(3), 0.03 + 0.05 * draw(1), 0.3 + 0.5 * draw(1),
                  0.02 * draw(1), 2.0 / 64)  # fmt: skip


def test_the_truth_has_no_error_whatever_share_of_the_brightness_is_the_flashs() -> None:
    truth = _maps()
    scene = bench_scene(SETUP)
    brighter = replace(truth, diffuse=truth.diffuse * 0.5, specular=truth.specular * 0.5)
    for maps, intensity in ((truth, 8.0), (brighter, 16.0)):
        found = aligned_errors(maps, SETUP.with_intensity((intensity,) * 3), truth, SETUP, scene)
        assert set(found) == {name for name, _, _ in RINGS}
        assert found["all"].albedo == pytest.approx(0.0, abs=1e-5)
        assert found["all"].normal == pytest.approx(0.0, abs=0.1)
        assert found["all"].height == pytest.approx(1.0)
        assert found["all"].relit < 0.02  # Fresnel's rise from a halved F0


def test_relief_upside_down_has_the_wrong_sign_and_flat_relief_none() -> None:
    truth = _maps()
    scene = bench_scene(SETUP)
    turned = aligned_errors(replace(truth, height=-truth.height), SETUP, truth, SETUP, scene)
    assert turned["all"].height == pytest.approx(-1.0)
    flat = aligned_errors(replace(truth, height=0.0 * truth.height), SETUP, truth, SETUP, scene)
    assert flat["all"].height == 0.0
    assert turned["all"].relit > flat["all"].relit > 0.0


def test_what_is_wrong_at_the_rim_is_told_there() -> None:
    truth = _maps()
    roughness = truth.roughness.clone()
    roughness[..., :4] = 0.9
    found = aligned_errors(
        replace(truth, roughness=roughness), SETUP, truth, SETUP, bench_scene(SETUP)
    )
    assert found["foot"].roughness == 0.0
    assert found["rim"].roughness > 0.01
