"""What the renderer reads of a material: channels first, float32, with slopes beside the height."""

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
    """Extremes of a texture, over all its texels.

    Attributes:
        diffuse: largest albedo of any channel.
        specular: largest F0.
        roughness: (smallest, largest).
        slope: largest slope of the shading normals.
        relief_slope: largest slope of the bilinear surface through the heights, which repeats.
        relief: highest minus lowest height, in plane units.
    """

    diffuse: float
    specular: float
    roughness: tuple[float, float]
    slope: float
    relief_slope: float
    relief: float


@dataclass(frozen=True)
class Texture:
    """One rectangle of material; row 0 is the top, y is up.

    Attributes:
        diffuse: (3, H, W) albedo.
        specular: (1, H, W) F0, or (3, H, W) where it has a colour.
        roughness: (1, H, W) perceptual.
        height: (1, H, W) in plane units.
        slopes: (2, H, W) of the shading normal (-sx, -sy, 1): dh/dx and dh/dy.
        texel_size: in plane units.
        periodic: whether opposite borders fit each other.
    """

    diffuse: HorizonMap
    specular: HorizonMap
    roughness: HorizonMap
    height: HorizonMap
    slopes: HorizonMap
    texel_size: float
    periodic: bool = True

    @staticmethod
    def from_maps(maps: MapSet) -> Texture:
        """The texture of a map set without batch dimensions."""
        from matcap.brdf.heights import check_heights

        if maps.height.ndim != 3:
            raise ValueError("a map set is relit without batch dimensions")
        normal = maps.normal
        slopes = -normal[:2] / normal[2:]

        def array(tensor: object) -> HorizonMap:
            found: HorizonMap = tensor.detach().cpu().float().contiguous().numpy()  # type: ignore[attr-defined]
            return found

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
