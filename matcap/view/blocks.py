"""Blocks of the plane as the page fetches them: decoded once, a few at a time, the latest kept.

A block is SIDE texels a side, on the field's own grid. Its bytes are the six maps of
MapSet.stacked(), float32, little endian, one whole map after the other: exactly what Field.read
gives for that rectangle.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING

from matcap.view.subject import Subject

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet

SIDE = 512
_KEPT = 48  # blocks of 6.3 MB: as many as the page itself holds, and some to come back to


@dataclass(frozen=True)
class Place:
    """Which block: column and row of the grid, rows downwards; realisation; share of a blend."""

    column: int
    row: int
    seed: int = 0
    share: float = 0.0


@dataclass(frozen=True)
class Block:
    """A block's bytes and its texels' side in plane units."""

    data: bytes
    texel_size: float


class Blocks:
    """The blocks of a subject; safe to ask from any thread."""

    def __init__(self, subject: Subject, workers: int | None = None) -> None:
        self._subject = subject
        self._pool = ThreadPoolExecutor(workers or os.cpu_count(), thread_name_prefix="block")
        self._kept: OrderedDict[Place, Future[Block]] = OrderedDict()
        self._lock = Lock()

    def ask(self, place: Place) -> Future[Block]:
        """The block, perhaps still being decoded; its result raises what Subject.read does."""
        with self._lock:
            kept = self._kept.get(place)
            if kept is None or (kept.done() and kept.exception() is not None):
                self._kept[place] = self._pool.submit(self._decode, place)
            self._kept.move_to_end(place)
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
            return self._kept[place]

    def close(self) -> None:
        """Forget what has not been begun."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _decode(self, place: Place) -> Block:
        maps = self._subject.read(
            place.column * SIDE, place.row * SIDE, SIDE, SIDE, seed=place.seed, share=place.share
        )
        return Block(planes(maps), maps.texel_size)


def planes(maps: MapSet) -> bytes:
    """The stacked maps as little-endian float32, one map after the other."""
    return maps.stacked().contiguous().numpy().astype("<f4", copy=False).tobytes()
