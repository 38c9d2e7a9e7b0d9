"""Blocks of the plane as the page fetches them: decoded once, a few at a time, the latest kept.

The bands of one block are decoded side by side, so that a block asked for alone does not wait for
one core while others idle.

A block is SIDE texels a side, on the field's own grid. Its bytes are the six maps of
MapSet.stacked(), float32, little endian, one whole map after the other: exactly what Field.read
gives for that rectangle.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING

from matcap.model.blocks import BLOCK_HEIGHT
from matcap.view.subject import Viewable

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet

SIDE = 512
_BAND = BLOCK_HEIGHT  # rows decoded by one thread
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

    def __init__(self, subject: Viewable, workers: int | None = None) -> None:
        self._subject = subject
        workers = workers or os.cpu_count()
        self._decoders = ThreadPoolExecutor(workers, thread_name_prefix="band")
        self._joiners = ThreadPoolExecutor(workers, thread_name_prefix="block")
        self._kept: OrderedDict[Place, Future[Block]] = OrderedDict()
        self._lock = Lock()

    def ask(self, place: Place) -> Future[Block]:
        """The block, perhaps still being decoded; its result raises what Viewable.read does."""
        with self._lock:
            kept = self._kept.get(place)
            if kept is None or (kept.done() and kept.exception() is not None):
                self._kept[place] = self._joiners.submit(self._decode, place)
            self._kept.move_to_end(place)
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
            return self._kept[place]

    def close(self) -> None:
        """Forget what has not been begun."""
        self._joiners.shutdown(wait=True, cancel_futures=True)
        self._decoders.shutdown(wait=True, cancel_futures=True)

    def _decode(self, place: Place) -> Block:
        import torch

        tops = range(place.row * SIDE, (place.row + 1) * SIDE, _BAND)
        bands = list(self._decoders.map(partial(self._band, place), tops))
        stacked = torch.cat([band.stacked() for band in bands], dim=-2).numpy()
        return Block(stacked.astype("<f4", copy=False).tobytes(), bands[0].texel_size)

    def _band(self, place: Place, top: int) -> MapSet:
        return self._subject.read(
            place.column * SIDE, top, SIDE, _BAND, seed=place.seed, share=place.share
        )
