"""Measures walks in the space and how much realisations differ."""

from __future__ import annotations

import itertools

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.files.srgb import srgb_encode_tensor
from matcap.flash.geometry import FlashSetup
from matcap.flash.render import render_rectified
from matcap.lab.bench.style import RandomFilters, difference
from matcap.model.between import blend
from matcap.model.material import Material
from matcap.statistics.filterbank import FilterBank, FilterBankConfig, pyramid

_SIZE = 192
_FEATURES = FilterBankConfig(sizes=(7, 11), filters=24, levels=4, seed=777)


def walk(first: Material, second: Material, steps: int = 10) -> tuple[list[float], list[float]]:
    """Style distances from the first and from the second material, after 0 to `steps` steps."""
    style = RandomFilters()
    materials = [blend(first, second, step / steps) for step in range(steps + 1)]
    looks = [style(flash_picture(m.maps(_SIZE, _SIZE, seed=3), first.setup)) for m in materials]
    return (
        [float(difference(look, looks[0])) for look in looks],
        [float(difference(look, looks[-1])) for look in looks],
    )


def good_steps(distances: tuple[list[float], list[float]]) -> int:
    """Steps of a walk that lead away from its beginning and towards its end."""
    away, towards = (list(itertools.pairwise(d)) for d in distances)
    return sum(a[1] > a[0] and t[1] < t[0] for a, t in zip(away, towards, strict=True))


def flash_picture(maps: MapSet, setup: FlashSetup) -> Tensor:
    """(1, 3, H, W) maps under a flash, middle grey at the mean, as code values."""
    with torch.inference_mode():
        linear = render_rectified(maps.map(lambda m: m.float()), setup)
        exposed = (linear * (0.2 / linear.mean().clamp_min(1e-9))).clamp(0.0, 1.0)
        return srgb_encode_tensor(exposed)[None]


def apart(pictures: list[Tensor]) -> float:
    """Mean pairwise feature distance of realisations, place by place (the paper's diversity).

    Features are random filters' responses; the distance is L1, so another seed of the same
    material counts, and a copy counts nothing.
    """
    bank = FilterBank(_FEATURES)

    def features(picture: Tensor) -> list[Tensor]:
        return [bank.features(level) for level in pyramid(picture, _FEATURES.levels)]

    described = [features(picture) for picture in pictures]
    distances = [
        float(torch.stack([(a - b).abs().mean() for a, b in zip(one, two, strict=True)]).mean())
        for one, two in itertools.combinations(described, 2)
    ]
    return sum(distances) / len(distances)
