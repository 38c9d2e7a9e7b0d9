"""Sources that blocks of a field are read from, one interface for all generators."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.stated import NormalStyle
from matcap.field.blocks import RING, Grid
from matcap.field.plane import Period, Rectangle

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from matcap.brdf.maps import MapSet

# How a field is made: by rearranging the photographed piece, or by the paper's network.
Generator = Literal["example", "decoder"]
MAP_CHANNELS = 5  # diffuse (3), roughness, height; and as many as F0 has


class Source(Protocol):
    """Anything that blocks can be read from; picklable."""

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units."""
        ...

    @property
    def grid(self) -> Grid:
        """The blocks that the plane is cut into."""
        ...

    @property
    def period(self) -> Period | None:
        """What repeats."""
        ...

    @property
    def specular_channels(self) -> int:
        """Of F0: 1, or 3 where it has a colour."""
        ...

    @property
    def device_type(self) -> str:
        """Where it is computed: "cpu" or "cuda"."""
        ...

    def maps(self, block: Rectangle) -> Tensor:
        """Stacked maps (6 or 8, height + 2 RING, width + 2 RING) of a block and its ring."""
        ...

    def planes(self, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
        """(9 or 11, height, width) of a block: its maps and the normal."""
        ...


@runtime_checkable
class Network(Source, Protocol):
    """A source that a network computes, in a precision that can be chosen."""

    @property
    def device(self) -> torch.device:
        """Where it is computed."""
        ...

    def lowered(self, finest: int) -> Network:
        """The same in bfloat16 from level `finest` on to the coarser ones."""
        ...


class FieldGenerator(Protocol):
    """What makes a material's endless maps."""

    @property
    def alignment(self) -> int:
        """What periods of its field are multiples of, in texels."""
        ...

    @property
    def piece_size(self) -> tuple[int, int] | None:
        """(width, height) in texels of the photographed piece, where it holds that."""
        ...

    def piece(self) -> MapSet | None:
        """Maps of the photographed piece, where it holds that."""
        ...

    def varied(self, variety: float) -> FieldGenerator:
        """The same with pieces of another size, from 0, the whole one repeated, to 1.

        Raises:
            UsageError: out of range, or it has no pieces.
        """
        ...

    def source(self, seed: int, period: Period | None, device: torch.device) -> Source:
        """Its field.

        Raises:
            UsageError: a seed or period out of range.
        """
        ...

    def repeating(self) -> MapSet:
        """Maps of the photographed piece itself, made to repeat, at about its own size.

        Raises:
            UsageError: it holds no piece, or too small a one.
        """
        ...

    def in_file(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Tensors by name, and entries of the material's description."""
        ...


class Generated(Protocol):
    """What a field is read from: a material (material.py)."""

    def by(self, generator: Generator | None) -> Generated:
        """The same with one generator alone; with all where none is named."""
        ...

    @property
    def generator(self) -> FieldGenerator:
        """The one that makes its maps."""
        ...


def planes_of(source: Source, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
    """(9 or 11, height, width) of a block, on the processor: its maps and the normal."""
    import torch

    from matcap.brdf.normals import normals_from_slopes

    with torch.inference_mode():
        maps = source.maps(block)
        height, size = maps[-1:], 2 * source.texel_size
        below, above = height[:, 2 * RING :, RING:-RING], height[:, : -2 * RING, RING:-RING]
        right, left = height[:, RING:-RING, 2 * RING :], height[:, RING:-RING, : -2 * RING]
        normals = normals_from_slopes((right - left) / size, (above - below) / size)
        if normal == "dx":
            normals[1].neg_()
        planes: NDArray[np.float32] = torch.cat([inner(maps), normals]).cpu().numpy()
        return planes


def inner(maps: Tensor) -> Tensor:
    """A block's maps without their ring."""
    return maps[..., RING:-RING, RING:-RING]
