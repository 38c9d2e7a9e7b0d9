"""Normals of a height field by central differences."""

from __future__ import annotations

import torch
from torch import Tensor


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
    along = (normal * vector).sum(0, keepdim=True)
    return normal[2:] * (normal[:2] * along - vector[:2])


def _one_sided_at_borders(field: Tensor, dim: int) -> Tensor:
    """Differences per texel along dim: central inside, one-sided at both ends."""
    size = field.shape[dim]
    if size == 1:
        return torch.zeros_like(field)
    inner = (field.narrow(dim, 2, size - 2) - field.narrow(dim, 0, size - 2)) / 2.0
    first = field.narrow(dim, 1, 1) - field.narrow(dim, 0, 1)
    last = field.narrow(dim, size - 1, 1) - field.narrow(dim, size - 2, 1)
    return torch.cat([first, inner, last], dim=dim)
