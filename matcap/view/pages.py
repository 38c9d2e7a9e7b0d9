"""Pages: rectangles of the endless plane, at mip levels, that the browser fetches.

A texel of level k is 2^k texels of the material wide. Each level is cut into pages of WIDTH x
PAGE_HEIGHT texels. A page has an apron of APRON texels and its own smaller mip levels (MIPS in
all), so that it is filtered without its neighbours.

A page's bytes, for each of its mip levels, largest first, little endian, rows from the top: diffuse
albedo and F0 (four half floats a texel); alpha^2, slopes along x and y, and slope variance (four
floats); height (a float). Where F0 has a colour, its red is next to the albedo, and its green and
blue (two half floats) follow the height.
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

# With their apron powers of two, so that texture coordinates are exact on graphics cards.
WIDTH, PAGE_HEIGHT = 496, 240
APRON = 8  # texels, so that one is left at the smallest mip level
MIPS = 4
MOST_LEVEL = 24
_KEPT = 64  # pages cached, of 5.3 MB each; more than are visible at once


@dataclass(frozen=True)
class Place:
    """Address of a page."""

    level: int
    column: int
    """Column in the level's grid of pages."""
    row: int
    seed: int = 0
    """Seed of the realisation."""
    share: float = 0.0
    """Share of the second material of a blend."""
    piece: bool = False
    """Whether the page is of the exemplar instead of the field."""

    @property
    def area(self) -> Rectangle:
        """The page with its apron, in texels of its level."""
        return Rectangle(self.column * WIDTH, self.row * PAGE_HEIGHT, WIDTH, PAGE_HEIGHT).grown(
            APRON
        )


@dataclass(frozen=True)
class Page:
    """A page of moments."""

    data: bytes
    """Encoded moments (module docstring)."""
    texel_size: float
    """A texel's side at level 0, in plane units."""
    ends: tuple[tuple[float, float], ...]
    """(least, greatest) F0 of any channel, roughness and height."""
    specular_channels: int
    """Channels of F0, 1 or 3."""


class Pages:
    """Computes and caches the pages of a subject; thread-safe."""

    def __init__(self, subject: Viewable, workers: int | None = None) -> None:
        self._subject = subject
        self._makers = ThreadPoolExecutor(workers or os.cpu_count(), thread_name_prefix="page")
        self._kept: OrderedDict[Place, Future[Page]] = OrderedDict()
        self._lock = Lock()

    def ask(self, place: Place) -> Future[Page]:
        """Future of a page; its result raises what Viewable.moments does."""
        with self._lock:
            kept = self._kept.get(place)
            if kept is None or kept.cancelled() or (kept.done() and kept.exception() is not None):
                self._kept[place] = self._makers.submit(self._make, place)
            self._kept.move_to_end(place)
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
            return self._kept[place]

    def drop(self, place: Place) -> None:
        """Cancel a page's computation unless it has begun."""
        with self._lock:
            kept = self._kept.get(place)
            if kept is not None and kept.cancel():
                del self._kept[place]

    def close(self) -> None:
        """Cancel what has not begun, and wait for the rest."""
        self._makers.shutdown(wait=True, cancel_futures=True)

    def _make(self, place: Place) -> Page:
        area, level = place.area, place.level
        if not 0 <= level <= MOST_LEVEL:
            says = f"there is no level {level}"
            raise UsageError(says, remedy=f"give one from 0 to {MOST_LEVEL}")
        if max(abs(area.x), abs(area.y)) << level > COORDINATE_LIMIT:
            raise UsageError("this page lies beyond 2^40 texels", remedy="stay nearer")
        moments, texel_size = self._subject.moments(
            level, area, seed=place.seed, share=place.share, piece=place.piece
        )
        return packed(moments, texel_size)


def packed(moments: Planes, texel_size: float) -> Page:
    """Encode moments (9 or 11, PAGE_HEIGHT + 2 APRON, WIDTH + 2 APRON) as a page."""
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
        # Slope variance: 0 at level 0.
        varies = np.square(moments[SLOPE_X]) + np.square(moments[SLOPE_Y])
        surface[..., 3] = np.maximum(moments[SQUARES] - varies, 0.0)
        parts += [albedo, surface.tobytes(), moments[HEIGHT].astype("<f4").tobytes(), metal]
    return Page(b"".join(parts), texel_size, ends, channels)


def _halves(planes: Planes) -> bytes:
    """Bytes of planes as half floats, channels last; empty for no planes."""
    return np.ascontiguousarray(planes.transpose(1, 2, 0)).astype("<f2").tobytes()
