"""Whether windows tell where they were cut."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch.nn.functional import avg_pool2d

from matcap.brdf.maps import MapSet
from matcap.flash.geometry import FlashSetup
from matcap.lab.bench.aligned import from_foot
from matcap.lab.bench.drift import drift
from matcap.lab.bench.relit import bench_scene

SETUP = FlashSetup(fov=60.0, offset=(0.1, 0.0, 0.0), intensity=(8.0,) * 3)


def _drift(maps: MapSet) -> float:
    return drift(maps, SETUP.intensity, bench_scene(SETUP), from_foot(maps, SETUP))


def test_relief_that_fades_under_the_flash_tells_and_even_relief_hardly() -> None:
    one = torch.ones(1, 384, 512)
    bumps = torch.randn(1, 1, 388, 516, generator=torch.Generator().manual_seed(1))
    height = 0.01 * avg_pool2d(bumps, 5, stride=1)[0]
    even = MapSet(0.3 * one.expand(3, -1, -1), 0.04 * one, 0.5 * one, height, 2.0 / 512)
    fading = (from_foot(even, SETUP) / 0.7).clamp_max(1.0)
    told = _drift(even)
    assert 0.0 < told < 0.15
    assert _drift(replace(even, height=height * fading)) > 2.0 * told


def test_a_picture_without_both_places_tells_nothing() -> None:
    one = torch.ones(1, 128, 128)
    maps = MapSet(0.3 * one.expand(3, -1, -1), 0.04 * one, 0.5 * one, 0.0 * one, 2.0 / 128)
    assert math.isnan(_drift(maps))
