"""Whether maps repeat without a seam: the step across the border compared with those inside."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

    from matcap.brdf.maps import MapSet

SEAMLESS = 1.15  # an invisible ratio: single lines of a texture scatter by as much
_LINES = 0.9  # of the lines inside


def seam_ratio(maps: MapSet) -> float:
    """How much larger steps are where maps meet themselves than anywhere else in them.

    The mean absolute difference of neighbouring texels across the wrap over that of lines inside,
    mean over the maps, of the worse axis. Not the mean line inside but one that nine of ten do not
    exceed: threads and planks have edges, and the wrap may fall on one. About 1 or less where there
    is no seam; 1 for maps that hold nothing.
    """
    return max(
        sum(_ratio(channels, axis) for channels in _each(maps)) / len(_each(maps))
        for axis in (-1, -2)
    )


def _each(maps: MapSet) -> tuple[Tensor, ...]:
    return maps.diffuse, maps.specular, maps.roughness, maps.height


def _ratio(channels: Tensor, axis: int) -> float:
    """Of one map along one axis."""
    if channels.shape[axis] < 3:
        return 1.0
    values, other = channels.detach(), -3 - axis
    # One channel at a time: large maps have no room beside them for copies of their own size.
    across = sum(one.diff(dim=axis).abs_().mean(dim=other).double() for one in values)
    inside = float(across.quantile(_LINES)) / len(values)
    wrap = float((values.select(axis, 0) - values.select(axis, -1)).abs().mean())
    least = 1e-6 * float(values.abs().max())  # rounding
    return (wrap + least) / (inside + least) if least > 0.0 else 1.0
