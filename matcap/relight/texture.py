"""Maps of a material as the renderer reads them: channels first, float32, normals as slopes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from matcap.relight.vectors import Array

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet

MIN_ROUGHNESS = 1e-3  # as matcap.brdf


def alpha_of(roughness: Array) -> Array:
    """GGX alpha of perceptual roughness: its square, at least 1e-6."""
    return np.square(np.maximum(roughness, roughness.dtype.type(MIN_ROUGHNESS)))


@dataclass(frozen=True)
class Extremes:
    """Extremes of a texture, over all its texels."""

    diffuse: float
    """Largest albedo of any channel."""
    specular: float
    """Largest F0 of any channel."""
    roughness: tuple[float, float]
    """(smallest, largest) roughness."""
    slope: float
    """Largest |slope| of the shading normals."""
    relief_slope: float
    """Largest |slope| of the bilinear surface through the heights, across repetitions, too."""
    relief: float
    """Highest minus lowest height, in plane units."""


@dataclass(frozen=True)
class Texture:
    """A rectangle of material; row 0 is the top, y points up."""

    diffuse: Array
    """(3, H, W) albedo."""
    specular: Array
    """(1, H, W) F0, or (3, H, W) where it is coloured."""
    roughness: Array
    """(1, H, W) perceptual roughness, sqrt of GGX alpha."""
    height: Array
    """(1, H, W) in plane units."""
    slopes: Array
    """(2, H, W) dh/dx and dh/dy of the shading normal (-dh/dx, -dh/dy, 1)."""
    texel_size: float
    """Side of a texel, plane units."""
    periodic: bool = True
    """Whether the maps tile seamlessly."""

    @staticmethod
    def from_maps(maps: MapSet) -> Texture:
        """The texture of a map set.

        Raises:
            ValueError: the maps have batch dimensions.
            MatcapError: heights that single precision cannot hold (check_heights).
        """
        from matcap.brdf.heights import check_heights

        if maps.height.ndim != 3:
            raise ValueError("maps with batch dimensions cannot be rendered: pass one map set")
        normal = maps.normal
        slopes = -normal[:2] / normal[2:]
        tensors = (maps.diffuse, maps.specular, maps.roughness, maps.height, slopes)
        a, b, c, d, e = (one.detach().cpu().float().contiguous().numpy() for one in tensors)
        check_heights(d, "the material")
        return Texture(a, b, c, d, e, maps.texel_size, maps.periodic)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in texels."""
        return self.height.shape[2], self.height.shape[1]

    @property
    def extent(self) -> tuple[float, float]:
        """(width, height) in plane units."""
        return self.size[0] * self.texel_size, self.size[1] * self.texel_size

    @cached_property
    def normal(self) -> Array:
        """(3, H, W) unit shading normals."""
        x, y = self.slopes
        z = 1.0 / np.sqrt(1.0 + x * x + y * y)
        return np.stack([-x * z, -y * z, z])

    @cached_property
    def brightest(self) -> tuple[float, float, float]:
        """Largest albedo of each channel."""
        red, green, blue = (float(channel.max()) for channel in self.diffuse)
        return red, green, blue

    @cached_property
    def extremes(self) -> Extremes:
        """Largest and smallest values of the maps and slopes over all texels, for bounds."""
        height = self.height[0]
        # A bilinear cell's derivatives are between those along its sides.
        across = np.abs(np.roll(height, -1, axis=1) - height)
        down = np.abs(np.roll(height, -1, axis=0) - height)
        across = np.maximum(across, np.roll(across, -1, axis=0))
        down = np.maximum(down, np.roll(down, -1, axis=1))
        steepest = float((across * across + down * down).max()) ** 0.5 / self.texel_size
        x, y = self.slopes
        return Extremes(
            float(self.diffuse.max()),
            float(self.specular.max()),
            (float(self.roughness.min()), float(self.roughness.max())),
            float((x * x + y * y).max()) ** 0.5,
            steepest,
            float(height.max() - height.min()),
        )
