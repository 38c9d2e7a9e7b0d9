"""Highlight contrast under mirrored lights, and highlight residue in maps."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.verdict.highlight import FAR, NEAR
from matcap.flash.geometry import plane_points
from matcap.flash.render import shade
from matcap.lab.measures.lights import BenchScene

_OCTAVES, _SECTORS = 5, 8
_LEAST = 0.01  # of the strongest octave's energy
_RINGS = 0.84  # of the shorter half side: radii whose rings lie in the map whole


def mirror_point(scene: BenchScene, place: tuple[float, float, float]) -> tuple[float, float]:
    """Mirror point in the plane of a light at a place, for the scene's camera; plane units."""
    share = scene.distance / (scene.distance + place[2])
    return share * place[0], share * place[1]


def highlight_contrast(maps: MapSet, scene: BenchScene) -> float:
    """Mean of L / L_matte near the mirror point over its mean far from it; 1 is a matte surface.

    L_matte is a uniform matte plane's radiance. Geometric mean over the scene's lights.

    Args:
        maps: in the middle of the plane, wide enough to hold every light's mirror point.
        scene: camera and lights.
    """
    width, height = maps.size
    half = maps.texel_size * width / 2.0
    points = half * plane_points(0, 0, width, height, (width, height), dtype=torch.float32)
    camera, one = torch.tensor([0.0, 0.0, scene.distance]), torch.ones(1, height, width)
    matte = MapSet(0.2 * one.expand(3, -1, -1), 1e-6 * one, one, 0.0 * one, maps.texel_size)
    floats = maps.map(lambda m: m.detach().float())
    logs = []
    for light in scene.lights:
        place, power = torch.tensor(light.place), torch.full((3,), light.strength)
        lit, even = (shade(each, points, camera, place, power).mean(0) for each in (floats, matte))
        x, y = mirror_point(scene, light.place)
        distance = torch.hypot(points[0] - x, points[1] - y)
        ratio = lit / even
        logs.append((ratio[distance < NEAR].mean() / ratio[distance > FAR].mean()).log())
    return float(torch.stack(logs).mean().exp())


def imprint(plane: Tensor, towards: tuple[float, float]) -> float:
    """Radial anisotropy of a map about the flash's mirror point, in [-1, 1]; 0 if isotropic.

    (E_r - E_t) / (E_r + E_t), E the mean squares of radial and tangential gradients of a band of
    one octave over a disc around the point; the octave where it is largest in magnitude.

    Args:
        plane: (H, W) a map, or its logarithm.
        towards: x, y of the point from the middle, in half widths.
    """
    values = plane.detach().numpy().astype(np.float32)
    height, width = values.shape
    v, u = np.mgrid[:height, :width] + 0.5
    x, y = u - (towards[0] + 1.0) * width / 2.0, v - (height - towards[1] * width) / 2.0
    distance = np.maximum(np.hypot(x, y), 1.0)
    whole = distance < _RINGS * 0.5 * min(height, width)
    sector = (np.arctan2(y, x) / (2.0 * np.pi) % 1.0 * _SECTORS).astype(int) % _SECTORS
    energies = []
    for octave in range(_OCTAVES):
        band = _blurred(values, 2.0**octave) - _blurred(values, 2.0 ** (octave + 1))
        down, across = np.gradient(band)
        radial = np.square((across * x + down * y) / distance)
        around = np.square((across * -y + down * x) / distance)
        sums = [
            (radial[whole & (sector == k)].mean(), around[whole & (sector == k)].mean())
            for k in range(_SECTORS)
        ]
        energies.append(np.array(sums).mean(0))
    # The ratio of an octave with hardly any gradient energy is noise.
    least = max(_LEAST * max(float(each.sum()) for each in energies), 1e-12)
    ratios = [float((a - b) / (a + b)) for a, b in energies if a + b > least]
    return max(ratios, key=abs, default=0.0)


def _blurred(plane: NDArray[np.float32], deviation: float) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(plane, (0, 0), deviation), np.float32)
