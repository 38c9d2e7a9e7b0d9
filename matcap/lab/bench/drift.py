"""Whether a relit window tells by its statistics how far from the flash it was photographed.

A stationary sample's windows differ by chance alone; what a photograph tells less of under the
flash's foot, or less of at the rim, makes them differ by place. So windows near the foot are
compared with windows near the rim, every one relit in the middle of the plane, where all have the
same light.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.lab.bench.relit import BenchScene, relight
from matcap.lab.bench.style import Group, RandomFilters, Statistics, difference

_WINDOW, _STRIDE = 128, 96  # texels
_FOOT, _RIM = 0.35, 0.75  # plane units from the foot: nearer, and further
_LIGHTS = 3  # every third of the bench's


def drift(
    maps: MapSet, intensity: tuple[float, float, float], scene: BenchScene, distance: Tensor
) -> float:
    """Style distance between relit windows near the flash's foot and near the rim.

    By random filters; statistics are averaged over the windows of each place. NaN where there is
    no window near the one or the other.

    Args:
        maps: of the whole plane rectangle.
        intensity: of the flash that goes with them.
        scene: camera and lights.
        distance: (H, W) of texels from the flash's foot, plane units.
    """
    style = RandomFilters()
    foot: list[Statistics] = []
    rim: list[Statistics] = []
    width, height = maps.size
    for y in range(0, height - _WINDOW + 1, _STRIDE):
        for x in range(0, width - _WINDOW + 1, _STRIDE):
            away = float(distance[y + _WINDOW // 2, x + _WINDOW // 2])
            if _FOOT <= away < _RIM:
                continue
            window = maps.crop(x, y, _WINDOW, _WINDOW)
            lights = scene.lights[::_LIGHTS]
            pictures = [relight(window, intensity, scene, light) for light in lights]
            (foot if away < _FOOT else rim).append(style(torch.stack(pictures)))
    if not (foot and rim):
        return float("nan")
    return float(difference(_mean(foot), _mean(rim)).mean())


def _mean(found: Sequence[Statistics]) -> Statistics:
    """Statistics of many windows."""
    return {
        name: Group(torch.stack([f[name].values for f in found]).mean(0), group.unseen)
        for name, group in found[0].items()
    }
