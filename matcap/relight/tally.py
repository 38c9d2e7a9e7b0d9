"""Which tiles of the picture each effect ran in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from matcap.relight.vectors import Array

TILE = 32  # pixels a side


@dataclass(frozen=True)
class Tally:
    """Effects by tiles, filled while a picture is made."""

    size: tuple[int, int]
    """(width, height) of the picture in pixels."""
    _ran: dict[str, Array] = field(default_factory=dict)

    @property
    def tiles(self) -> tuple[int, int]:
        """How many tiles there are across and down."""
        return -(-self.size[0] // TILE), -(-self.size[1] // TILE)

    def of(self, top: int, bottom: int, left: int, right: int) -> Array:
        """(rows, columns) the tile that each pixel of a rectangle is in."""
        row, column = np.arange(top, bottom) // TILE, np.arange(left, right) // TILE
        tiles: Array = row[:, None] * self.tiles[0] + column
        return tiles

    def ran(self, effect: str, tiles: Array) -> None:
        """Note the tiles of pixels that an effect ran in."""
        across, down = self.tiles
        self._ran.setdefault(effect, np.zeros(across * down, dtype=bool))[tiles] = True

    def shares(self) -> Mapping[str, float]:
        """The share of all tiles that each effect ran in."""
        return {effect: float(ran.mean()) for effect, ran in self._ran.items()}

    def maps(self) -> Mapping[str, Array]:
        """(down, across) whether each effect ran, for those that did anywhere."""
        across, down = self.tiles
        return {effect: ran.reshape(down, across) for effect, ran in self._ran.items()}
