"""Pages: the pieces of the endless plane that the page in the browser fetches.

The plane is seen at levels: a texel of level k is 2^k texels of the material wide. At every level
it is cut into pages of WIDTH x HEIGHT texels. A page comes with APRON texels around it and with its
own smaller levels (MIPS in all), so that it is filtered without its neighbours.

A page's bytes, for each of its levels, the largest first: albedo and F0 (four half floats a
texel), surface (alpha squared, slopes along x and y, their variance: four floats), height (a
float); little endian, rows from the top. Where F0 has a colour, the F0 beside the albedo is that of
red, and after the height come those of green and blue (two half floats).
"""

from __future__ import annotations

import os
from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from threading import Lock

import numpy as np

from matcap.errors import UsageError
from matcap.field.plane import COORDINATE_LIMIT, Rectangle
from matcap.view.moments import (
    ALBEDO,
    ALPHA2,
    F0,
    HEIGHT,
    SLOPE_X,
    SLOPE_Y,
    SQUARES,
    Planes,
    halved,
)
from matcap.view.subject import Viewable

# With their apron powers of two, so that places in them are exact on graphics cards.
WIDTH, PAGE_HEIGHT = 496, 240
APRON = 8  # texels: one is left of it on the smallest of a page's levels
MIPS = 4
MOST_LEVEL = 24
_KEPT = 64  # pages of 5.3 MB: as many as are seen at once, and some to come back to


@dataclass(frozen=True)
class Place:
    """Which page: level, column and row of its grid; realisation; share of a blend; whether it is
    of the photographed piece.
    """

    level: int
    column: int
    row: int
    seed: int = 0
    share: float = 0.0
    piece: bool = False

    @property
    def area(self) -> Rectangle:
        """With its apron, in texels of its level."""
        return Rectangle(self.column * WIDTH, self.row * PAGE_HEIGHT, WIDTH, PAGE_HEIGHT).grown(
            APRON
        )


@dataclass(frozen=True)
class Page:
    """A page."""

    data: bytes
    """Its bytes."""
    texel_size: float
    """A texel's side in plane units."""
    ends: tuple[tuple[float, float], ...]
    """Lowest and highest F0 of any channel, roughness and height on it."""
    specular_channels: int
    """Of F0, 1 or 3."""


class Pages:
    """The pages of a subject; safe to ask from any thread."""

    def __init__(self, subject: Viewable, workers: int | None = None) -> None:
        self._subject = subject
        self._makers = ThreadPoolExecutor(workers or os.cpu_count(), thread_name_prefix="page")
        self._kept: OrderedDict[Place, Future[Page]] = OrderedDict()
        self._lock = Lock()

    def ask(self, place: Place) -> Future[Page]:
        """The page, perhaps still being made; its result raises what Viewable.moments does."""
        with self._lock:
            kept = self._kept.get(place)
            if kept is None or kept.cancelled() or (kept.done() and kept.exception() is not None):
                self._kept[place] = self._makers.submit(self._make, place)
            self._kept.move_to_end(place)
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
            return self._kept[place]

    def drop(self, place: Place) -> None:
        """The request was cancelled: it is not begun, unless it already was."""
        with self._lock:
            kept = self._kept.get(place)
            if kept is not None and kept.cancel():
                del self._kept[place]

    def close(self) -> None:
        """Forget what has not been begun."""
        self._makers.shutdown(wait=True, cancel_futures=True)

    def _make(self, place: Place) -> Page:
        area, step = place.area, 1 << check_level(place.level)
        if max(abs(area.x), abs(area.y)) * step > COORDINATE_LIMIT:
            raise UsageError("this page lies beyond 2^40 texels", remedy="stay nearer")
        moments, texel_size = self._subject.moments(
            place.level, area, seed=place.seed, share=place.share, piece=place.piece
        )
        return packed(moments, texel_size)


def check_level(level: int) -> int:
    """The level, or a UsageError where there is none such."""
    if not 0 <= level <= MOST_LEVEL:
        raise UsageError(f"there is no level {level}", remedy=f"give one from 0 to {MOST_LEVEL}")
    return level


def packed(moments: Planes, texel_size: float) -> Page:
    """A page of moments (9 or 11, PAGE_HEIGHT + 2 APRON, WIDTH + 2 APRON)."""
    rough = np.sqrt(np.sqrt(moments[ALPHA2]))
    channels = len(moments[F0])
    ends = tuple((float(m.min()), float(m.max())) for m in (moments[F0], rough, moments[HEIGHT]))
    parts = []
    for mip in range(MIPS):
        moments = halved(moments) if mip else moments
        albedo, metal = _halves(moments[ALBEDO][:4]), _halves(moments[ALBEDO][4:])
        surface = np.empty((*moments.shape[1:], 4), "<f4")
        surface[..., 0] = moments[ALPHA2]
        surface[..., 1], surface[..., 2] = moments[SLOPE_X], moments[SLOPE_Y]
        # Within the finest texels nothing varies.
        varies = np.square(moments[SLOPE_X]) + np.square(moments[SLOPE_Y])
        surface[..., 3] = np.maximum(moments[SQUARES] - varies, 0.0)
        parts += [albedo, surface.tobytes(), moments[HEIGHT].astype("<f4").tobytes(), metal]
    return Page(b"".join(parts), texel_size, ends, channels)


def _halves(planes: Planes) -> bytes:
    """Planes as half floats, channels last; nothing of none."""
    return np.ascontiguousarray(planes.transpose(1, 2, 0)).astype("<f2").tobytes()
