"""Protocols of generators and of the sources of a field's blocks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.stated import NormalStyle
from matcap.field.plane import RING, Grid, Period, Rectangle

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from matcap.brdf.maps import MapSet

# "example" rearranges the exemplar; "decoder" is the paper's network.
Generator = Literal["example", "decoder"]
MAP_CHANNELS = 5  # diffuse (3), roughness, height; F0 adds 1 or 3


class Source(Protocol):
    """A field that blocks can be read from; picklable."""

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units."""

    @property
    def grid(self) -> Grid:
        """The grid of blocks."""

    @property
    def period(self) -> Period | None:
        """Period along (x, y), texels; None if the field never repeats."""

    @property
    def specular_channels(self) -> int:
        """Channels of F0: 1, or 3 where it has a colour."""

    @property
    def device_type(self) -> str:
        """Device that computes it: "cpu" or "cuda"."""

    def maps(self, block: Rectangle) -> Tensor:
        """Stacked maps (6 or 8, height + 2 RING, width + 2 RING) of a block and its ring."""

    def planes(self, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
        """(9 or 11, height, width) maps and normal of a block."""


class FieldGenerator(Protocol):
    """A generator of endless maps, as a material holds it."""

    @property
    def alignment(self) -> int:
        """Texels: periods of its field are multiples of this."""

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units."""

    @property
    def piece_size(self) -> tuple[int, int] | None:
        """(width, height) of its exemplar in texels, or None."""

    def piece(self) -> MapSet | None:
        """Maps of its exemplar, or None."""

    def varied(self, variety: float) -> FieldGenerator:
        """A copy of another variety (ReadOptions.variety).

        Raises:
            UsageError: out of range, or it has no exemplar.
        """

    def source(self, seed: int, period: Period | None, device: torch.device) -> Source:
        """The field of a seed and period, computed on a device.

        Raises:
            UsageError: a seed or period out of range.
        """

    def repeating(self) -> MapSet:
        """Maps of its exemplar as a seamless tile, each side about three quarters of its own.

        Raises:
            UsageError: it has no exemplar, or too small a one.
        """

    def in_file(
        self, by_example: FieldGenerator | None = None
    ) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Tensors by name, and entries of the JSON description, for the material's file.

        `by_example` is the generator whose exemplar the file has already.
        """


class Generated(Protocol):
    """Interface of Material (material.py) that Field uses."""

    def by(self, generator: Generator | None) -> Generated:
        """A copy with only this generator; itself for None."""

    @property
    def generator(self) -> FieldGenerator:
        """The generator that makes its maps."""


def planes_of(source: Source, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
    """(9 or 11, height, width) maps and normal of a block, on the processor."""
    import torch

    from matcap.brdf.maps import normals_from_slopes

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
    """(..., h, w) of maps (..., h + 2 RING, w + 2 RING)."""
    return maps[..., RING:-RING, RING:-RING]
