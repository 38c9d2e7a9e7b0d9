"""What the renderer reads of a material: channels first, float32, with slopes beside the height."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet

Map = NDArray[np.float32]


@dataclass(frozen=True)
class Texture:
    """One rectangle of material; row 0 is the top, y is up.

    Attributes:
        diffuse: (3, H, W) albedo.
        specular: (1, H, W) F0, or (3, H, W) where it is coloured (metals of foreign map sets).
        roughness: (1, H, W) perceptual.
        height: (1, H, W) in plane units.
        slopes: (2, H, W) of the shading normal (-sx, -sy, 1): dh/dx and dh/dy.
        texel_size: in plane units.
    """

    diffuse: Map
    specular: Map
    roughness: Map
    height: Map
    slopes: Map
    texel_size: float

    @staticmethod
    def from_maps(maps: MapSet) -> Texture:
        """The texture of a map set without batch dimensions."""
        if maps.height.ndim != 3:
            raise ValueError("a map set is relit without batch dimensions")
        normal = maps.normal
        slopes = -normal[:2] / normal[2:]

        def array(tensor: object) -> Map:
            found: Map = tensor.detach().cpu().float().contiguous().numpy()  # type: ignore[attr-defined]
            return found

        return Texture(
            array(maps.diffuse),
            array(maps.specular),
            array(maps.roughness),
            array(maps.height),
            array(slopes),
            maps.texel_size,
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
    def normal(self) -> Map:
        """(3, H, W) unit shading normals."""
        x, y = self.slopes
        z = 1.0 / np.sqrt(1.0 + x * x + y * y)
        return np.stack([-x * z, -y * z, z])
