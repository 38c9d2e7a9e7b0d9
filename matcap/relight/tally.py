"""Record of a picture's rendering: the tiles in which each effect ran, and the seconds it took."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Lock
from time import perf_counter

import numpy as np

from matcap.relight.vectors import Array

TILE = 32  # pixels a side


@dataclass(frozen=True)
class Tally:
    """Tiles and wall-clock seconds by effect, filled during rendering; threads may share one."""

    size: tuple[int, int]
    """(width, height) of the picture in pixels."""
    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    """Summed over threads."""
    _ran: dict[str, Array] = field(default_factory=dict)
    _lock: Lock = field(default_factory=Lock)

    @contextmanager
    def timed(self, effect: str) -> Iterator[None]:
        """Add the time spent inside the `with` block to an effect's seconds."""
        start = perf_counter()
        yield
        spent = perf_counter() - start
        with self._lock:
            self.seconds[effect] += spent

    @property
    def tiles(self) -> tuple[int, int]:
        """Number of tiles across and down."""
        return -(-self.size[0] // TILE), -(-self.size[1] // TILE)

    def of(self, top: int, bottom: int, left: int, right: int) -> Array:
        """(rows, columns) index of the tile of each pixel of a rectangle."""
        row, column = np.arange(top, bottom) // TILE, np.arange(left, right) // TILE
        return row[:, None] * self.tiles[0] + column

    def ran(self, effect: str, tiles: Array) -> None:
        """Record an effect in tiles, given by index."""
        across, down = self.tiles
        self._ran.setdefault(effect, np.zeros(across * down, dtype=bool))[tiles] = True

    def shares(self) -> Mapping[str, float]:
        """Share of all tiles, in [0, 1], in which each effect ran."""
        return {effect: float(ran.mean()) for effect, ran in self._ran.items()}

    def maps(self) -> Mapping[str, Array]:
        """(down, across) bool masks of tiles, of the effects that ran anywhere."""
        across, down = self.tiles
        return {effect: ran.reshape(down, across) for effect, ran in self._ran.items()}
