"""A material as the renderer reads it: channels first, float32, with slopes of the height."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from matcap.relight.vectors import Array

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet

HorizonMap = Array


@dataclass(frozen=True)
class Extremes:
    """Extremes of a texture, over all its texels."""

    diffuse: float
    """Largest albedo of any channel."""
    specular: float
    """Largest F0."""
    roughness: tuple[float, float]
    """(smallest, largest)."""
    slope: float
    """Largest slope of the shading normals."""
    relief_slope: float
    """Largest slope of the bilinear surface through the heights, which repeats."""
    relief: float
    """Highest minus lowest height, in plane units."""


@dataclass(frozen=True)
class Texture:
    """One rectangle of material; row 0 is the top, y is up."""

    diffuse: HorizonMap
    """(3, H, W) albedo."""
    specular: HorizonMap
    """(1, H, W) F0, or (3, H, W) where it has a colour."""
    roughness: HorizonMap
    """(1, H, W) perceptual."""
    height: HorizonMap
    """(1, H, W) in plane units."""
    slopes: HorizonMap
    """(2, H, W) of the shading normal (-sx, -sy, 1): dh/dx and dh/dy."""
    texel_size: float
    """In plane units."""
    periodic: bool = True
    """Whether opposite borders fit each other."""

    @staticmethod
    def from_maps(maps: MapSet) -> Texture:
        """The texture of a map set without batch dimensions."""
        from matcap.brdf.heights import check_heights

        if maps.height.ndim != 3:
            raise ValueError("a map set is relit without batch dimensions")
        normal = maps.normal
        slopes = -normal[:2] / normal[2:]

        def array(tensor: object) -> HorizonMap:
            plane: HorizonMap = tensor.detach().cpu().float().contiguous().numpy()  # type: ignore[attr-defined]
            return plane

        check_heights(array(maps.height), "the material")
        return Texture(
            array(maps.diffuse),
            array(maps.specular),
            array(maps.roughness),
            array(maps.height),
            array(slopes),
            maps.texel_size,
            maps.periodic,
        )

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in texels."""
        return self.height.shape[2], self.height.shape[1]

    @property
    def extent(self) -> tuple[float, float]:
        """(width, height) in plane units."""
        return self.size[0] * self.texel_size, self.size[1] * self.texel_size

    @cached_property
    def normal(self) -> HorizonMap:
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
        """Extremes, for the plan."""
        height = self.height[0]
        # Inside a cell a bilinear surface is nowhere steeper than along its sides.
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
