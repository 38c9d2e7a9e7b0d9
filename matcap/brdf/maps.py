"""MapSet: SVBRDF maps (diffuse albedo, F0, roughness, height) of a rectangle of material."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from matcap.brdf.normals import normals_from_height

# Order and channel counts of the stored maps; the normal is derived from the height. F0 has three
# channels where it is coloured, that is, where some of the material is metal.
CHANNELS: dict[str, int] = {"diffuse": 3, "specular": 1, "roughness": 1, "height": 1}
COLOURED = 3  # channels of a coloured F0
# Channels of stacked maps, with F0 coloured or not.
DIFFUSE, SPECULAR, ROUGHNESS, HEIGHT = (
    slice(0, 3), slice(3, -2), slice(-2, -1), slice(-1, None),
)  # fmt: skip
SURFACE = slice(0, -1)  # all but the height
MAP_NAMES: tuple[str, ...] = (*CHANNELS, "normal")


@dataclass(frozen=True)
class MapSet:
    """Maps of one rectangle of material, channels first, row 0 at the top (largest y).

    Leading batch dimensions are allowed; all four maps share them.
    """

    diffuse: Tensor
    """(3, H, W) diffuse albedo, linear Rec.709, in [0, 1]."""
    specular: Tensor
    """(1, H, W) F0, in [0, 1]; (3, H, W), linear Rec.709, where it is coloured."""
    roughness: Tensor
    """(1, H, W) perceptual roughness in [0, 1]; alpha is its square."""
    height: Tensor
    """(1, H, W) in plane units (half the photograph's long side)."""
    texel_size: float
    """A texel's side in plane units."""
    periodic: bool = False
    """The maps tile seamlessly."""
    painted: Tensor | None = None
    """(3, H, W) unit normals that replace the height's, read from an edited normal map
    (other_normals.py); not in stacked()."""

    def __post_init__(self) -> None:
        shape = self.height.shape
        for name, channels in CHANNELS.items():
            actual = getattr(self, name).shape
            allowed = (channels, COLOURED) if name == "specular" else (channels,)
            if len(actual) < 3 or actual[-3] not in allowed or actual[-2:] != shape[-2:]:
                raise ValueError(
                    f"{name} has shape {tuple(actual)}; expected (..., {channels}, "
                    f"{shape[-2]}, {shape[-1]})"
                )

    @property
    def normal(self) -> Tensor:
        """(3, H, W) unit normals, +Y up (OpenGL): `painted`, else derived from the height."""
        if self.painted is not None:
            return self.painted
        return normals_from_height(self.height, self.texel_size, periodic=self.periodic)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in texels."""
        return self.height.shape[-1], self.height.shape[-2]

    def stacked(self) -> Tensor:
        """(..., 6, H, W): diffuse, specular, roughness, height; 8 channels if F0 is coloured."""
        return torch.cat([self.diffuse, self.specular, self.roughness, self.height], dim=-3)

    @staticmethod
    def from_stacked(stacked: Tensor, texel_size: float, *, periodic: bool = False) -> MapSet:
        """The inverse of stacked()."""
        return MapSet(*split_stacked(stacked), texel_size, periodic)

    def map(self, change: Callable[[Tensor], Tensor]) -> MapSet:
        """The same set with `change` applied to each stored map (a dtype, a device, a crop)."""
        changed: dict[str, Any] = {name: change(getattr(self, name)) for name in CHANNELS}
        painted = None if self.painted is None else change(self.painted)
        return replace(self, **changed, painted=painted)

    def turned(self, quarters: int) -> MapSet:
        """The set rotated by `quarters` quarter turns anticlockwise, painted normals included."""

        def turn(planes: Tensor) -> Tensor:
            return planes.rot90(quarters, (-2, -1)).contiguous()

        rotated = self.map(turn)
        if rotated.painted is None:
            return rotated
        x, y, z = rotated.painted.unbind(-3)
        for _ in range(quarters % 4):
            x, y = -y, x
        return replace(rotated, painted=torch.stack([x, y, z], dim=-3))

    def crop(self, x: int, y: int, width: int, height: int) -> MapSet:
        """The width x height texels from column x, row y (top left), no longer periodic."""
        cut = self.map(lambda m: m[..., y : y + height, x : x + width])
        return replace(cut, periodic=False)


def specular_channels(stacked: int) -> int:
    """Number of F0's channels, of the number of stacked channels."""
    return stacked - sum(CHANNELS.values()) + CHANNELS["specular"]


def with_colour(stacked: Tensor) -> Tensor:
    """Stacked maps with F0 in three channels, (..., 8, H, W): one channel is repeated."""
    if specular_channels(stacked.shape[-3]) == COLOURED:
        return stacked
    grey = stacked[..., SPECULAR, :, :]
    rest = stacked[..., SPECULAR.stop :, :, :]
    return torch.cat([stacked[..., DIFFUSE, :, :], grey, grey, grey, rest], dim=-3)


def split_stacked(stacked: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Diffuse, specular, roughness and height of stacked maps, (..., 6 or 8, H, W)."""
    sizes = {**CHANNELS, "specular": specular_channels(stacked.shape[-3])}
    diffuse, specular, roughness, height = stacked.split(list(sizes.values()), dim=-3)
    return diffuse, specular, roughness, height
