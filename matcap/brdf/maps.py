"""MapSet: SVBRDF maps of a rectangle of material; normals and slopes of its height."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

# Normals of a height field by central differences.


def normals_from_height(height: Tensor, texel_size: float, *, periodic: bool = False) -> Tensor:
    """Unit normals of a height field.

    Args:
        height: (..., 1, H, W), in plane units. Row 0 is the top of the picture (largest y).
        texel_size: a texel's side in plane units.
        periodic: wrap around at borders; else differences there are one-sided.

    Returns:
        (..., 3, H, W) unit normals, +x right, +y up, +z towards the camera.
    """
    if periodic:
        right, left = torch.roll(height, -1, -1), torch.roll(height, 1, -1)
        below, above = torch.roll(height, -1, -2), torch.roll(height, 1, -2)
        dh_dx = (right - left) / (2.0 * texel_size)
        dh_dy = (above - below) / (2.0 * texel_size)
    else:
        dh_dx = _one_sided_at_borders(height, -1) / texel_size
        # Rows run downwards, y runs upwards.
        dh_dy = -_one_sided_at_borders(height, -2) / texel_size
    return normals_from_slopes(dh_dx, dh_dy)


def normals_of_rows(
    height: Tensor, texel_size: float, rows: slice, *, periodic: bool = False
) -> Tensor:
    """(..., 3, rows, W) some rows of normals_from_height, without computing the others.

    Args:
        height, texel_size, periodic: as normals_from_height.
        rows: slice with start and stop inside the field.
    """
    first, last = rows.start - 1, rows.stop + 1
    if periodic:
        around = torch.arange(first, last) % height.shape[-2]
        wide = normals_from_height(height[..., around, :], texel_size, periodic=True)
        return wide[..., 1:-1, :]
    first, last = max(first, 0), min(last, height.shape[-2])
    wide = normals_from_height(height[..., first:last, :], texel_size)
    return wide[..., rows.start - first : rows.stop - first, :]


def normals_from_slopes(dh_dx: Tensor, dh_dy: Tensor) -> Tensor:
    """(..., 3, H, W) unit normals of a surface with slopes (..., 1, H, W) along x and y."""
    inverse_length = torch.rsqrt(1.0 + dh_dx.square() + dh_dy.square())
    return torch.cat([-dh_dx * inverse_length, -dh_dy * inverse_length, inverse_length], dim=-3)


def by_slopes(normal: Tensor, vector: Tensor) -> Tensor:
    """(2, H, W) derivatives of n . u by both slopes: n_z (n_i (n . u) - u_i).

    Args:
        normal: (3, H, W) unit normals n.
        vector: (3, H, W) u, which is fixed.
    """
    return normal[2:] * (normal[:2] * (normal * vector).sum(0, keepdim=True) - vector[:2])


def _one_sided_at_borders(field: Tensor, dim: int) -> Tensor:
    """Differences per texel along dim: central inside, one-sided at both ends."""
    size = field.shape[dim]
    if size == 1:
        return torch.zeros_like(field)
    inner = (field.narrow(dim, 2, size - 2) - field.narrow(dim, 0, size - 2)) / 2.0
    first = field.narrow(dim, 1, 1) - field.narrow(dim, 0, 1)
    last = field.narrow(dim, size - 1, 1) - field.narrow(dim, size - 2, 1)
    return torch.cat([first, inner, last], dim=dim)


# MapSet: SVBRDF maps (diffuse albedo, F0, roughness, height) of a rectangle of material.

# Order and channel counts of the stored maps; the normal is derived from the height. F0 has three
# channels where it is coloured, that is, where some of the material is metal.
CHANNELS: dict[str, int] = {"diffuse": 3, "specular": 1, "roughness": 1, "height": 1}
COLOURED = 3  # channels of a coloured F0
# Channels of stacked maps, with F0 coloured or not.
DIFFUSE, SPECULAR, ROUGHNESS, HEIGHT = (
    slice(0, 3), slice(3, -2), slice(-2, -1), slice(-1, None),
)  # fmt: skip
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
    (edited.py); not in stacked()."""

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

    def normals_of(self, rows: slice) -> Tensor:
        """(3, rows, W) some rows of `normal`; all at once take five times their memory."""
        rows = slice(*rows.indices(self.size[1])[:2])
        if self.painted is not None:
            return self.painted[..., rows, :]
        return normals_of_rows(self.height, self.texel_size, rows, periodic=self.periodic)

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


def split_stacked(stacked: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Diffuse, specular, roughness and height of stacked maps, (..., 6 or 8, H, W)."""
    sizes = {**CHANNELS, "specular": specular_channels(stacked.shape[-3])}
    diffuse, specular, roughness, height = stacked.split(list(sizes.values()), dim=-3)
    return diffuse, specular, roughness, height


# Mean squared slopes of maps: as normals show them, between texels, and octave by octave.

_OCTAVES = 5  # the finest one texel's


def slope_energies(maps: MapSet) -> list[Tensor]:
    """(B,) mean squared slopes of maps (B, C, H, W): as normals show them, then by octave."""
    height = maps.height / maps.texel_size
    energies = [shown_energy(maps)]
    for octave in range(_OCTAVES):
        energies.append(energy_between(height) / 4.0**octave)
        height = F.avg_pool2d(height, 2)
    return energies


def relief_difference(maps: MapSet, others: MapSet, flat: float) -> Tensor:
    """(B,) mean over octaves of the absolute difference of log mean squared slope.

    Args:
        maps: (B, C, H, W).
        others: the maps that they are compared with.
        flat: root-mean-square slope that is added to both.
    """
    both = zip(slope_energies(maps), slope_energies(others), strict=True)
    ratios = [(ours + flat**2) / (theirs + flat**2) for ours, theirs in both]
    return torch.stack([ratio.log().abs() for ratio in ratios]).mean(0)


def shown_energy(maps: MapSet) -> Tensor:
    """(B,) mean squared slope of the normals."""
    normal = maps.normal
    return (normal[..., :2, :, :] / normal[..., 2:, :, :]).square().sum(-3).mean((-2, -1))


def energy_between(height: Tensor) -> Tensor:
    """(B,) mean squared difference between neighbouring texels of heights (B, 1, H, W)."""
    across, down = height.diff(dim=-1), height.diff(dim=-2)
    return across.square().mean((-3, -2, -1)) + down.square().mean((-3, -2, -1))
