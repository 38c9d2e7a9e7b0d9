"""Small materials and pictures that the relighting tests share."""

from dataclasses import replace

import numpy as np
import torch

from matcap.brdf.maps import MapSet


def bumpy(width=64, height=48, seed=0, relief=0.02, dtype=torch.float32) -> MapSet:
    """Smooth random maps: a few waves in every map, each texel different."""
    generator = np.random.default_rng(seed)
    x = (np.arange(width) + 0.5)[None, :] / width
    y = (np.arange(height) + 0.5)[:, None] / height

    def field() -> np.ndarray:
        total = np.zeros((height, width))
        for _ in range(5):
            fx, fy = generator.integers(-3, 4, size=2)
            total += np.cos(2 * np.pi * (fx * x + fy * y + generator.random()))
        return 0.5 + total / 10.0  # in [0, 1]

    def stack(*fields) -> torch.Tensor:
        return torch.from_numpy(np.stack(fields)).to(dtype)

    return MapSet(
        diffuse=stack(*(0.1 + 0.8 * field() for _ in range(3))),
        specular=stack(0.02 + 0.5 * field()),
        roughness=stack(0.15 + 0.7 * field()),
        height=stack(relief * field()),
        texel_size=2.0 / width,
        periodic=True,
    )


def coloured(maps: MapSet, seed: int = 0) -> MapSet:
    """The same, its F0 of any hue, another one at every texel."""
    draws = np.random.default_rng(seed).random((3, *maps.height.shape[1:]))
    hue = torch.from_numpy(draws).to(maps.specular.dtype)
    return replace(maps, specular=maps.specular * (0.3 + 0.7 * hue))


def flat(width=32, height=24, diffuse=0.5, specular=0.04, roughness=0.5) -> MapSet:
    """A material without any variation."""

    def full(channels: int, value: float) -> torch.Tensor:
        return torch.full((channels, height, width), float(value))

    return MapSet(
        full(3, diffuse), full(1, specular), full(1, roughness), full(1, 0.0), 2.0 / width
    )
