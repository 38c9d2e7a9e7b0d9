"""Visibility of the seam of repeating maps: the step across the border over steps inside."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

    from matcap.brdf.maps import MapSet

_LINES = 0.9  # quantile of the lines inside


def seam_ratio(maps: MapSet) -> float:
    """Ratio of the step across the wrap to the steps inside, mean over maps, of the worse axis.

    A step is the mean absolute difference of two adjacent lines of texels. The wrap is compared
    with the 0.9 quantile of the lines inside: threads and planks have edges, and the wrap may fall
    on one. About 1 or less without a seam, 1 for constant maps; up to 1.15 is invisible, since
    single lines of a texture scatter by as much.
    """
    each = (maps.diffuse, maps.specular, maps.roughness, maps.height)
    return max(sum(_ratio(one, axis) for one in each) / len(each) for axis in (-1, -2))


def _ratio(channels: Tensor, axis: int) -> float:
    """Step across the border over the step between lines inside, of one map (C, H, W)."""
    if channels.shape[axis] < 3:
        return 1.0
    values, other = channels.detach(), -3 - axis
    # One channel at a time: no copy as large as a whole map.
    across = sum(one.diff(dim=axis).abs_().mean(dim=other).double() for one in values)
    inside = float(across.quantile(_LINES)) / len(values)
    wrap = float((values.select(axis, 0) - values.select(axis, -1)).abs().mean())
    least = 1e-6 * float(values.abs().max())  # rounding
    return (wrap + least) / (inside + least) if least > 0.0 else 1.0
