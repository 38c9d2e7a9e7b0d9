"""Rectangles of the plane that the browser fetches, and the photograph."""

from __future__ import annotations

import base64
import os
from collections import OrderedDict
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from matcap.errors import UsageError
from matcap.example.example import Example
from matcap.field.material import Material
from matcap.field.plane import COORDINATE_LIMIT, Rectangle
from matcap.files.names import read_document
from matcap.files.pixels import jpeg_bytes
from matcap.flash.geometry import FlashSetup
from matcap.flash.rectify import picture_of, rectify
from matcap.photo.load import RAW_SUFFIXES, load_photo
from matcap.photo.photo import ToneCurve, standing
from matcap.view import level_of_detail as lod
from matcap.view.subject import Viewable

# Pages: rectangles of the endless plane, at mip levels, that the browser fetches.
#
# A texel of level k is 2^k texels of the material wide. Each level is cut into pages of WIDTH x
# PAGE_HEIGHT texels. A page has an apron of APRON texels and its own smaller mip levels (MIPS in
# all), so that it is filtered without its neighbours.
#
# A page's bytes, for each of its mip levels, largest first, little endian, rows from the top:
# diffuse albedo and F0 (four half floats a texel); alpha^2, slopes along x and y, and slope
# variance (four floats); height (a float). Where F0 has a colour, its red is next to the albedo,
# and its green and blue (two half floats) follow the height.

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
    """Computes and caches the pages of a subject; thread-safe.

    Attributes:
        subject: of the pages.
    """

    def __init__(self, subject: Viewable, workers: int | None = None) -> None:
        self.subject = subject
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
        moments, texel_size = self.subject.moments(level, area, seed=place.seed, share=place.share)
        return packed(moments, texel_size)


def packed(moments: lod.Planes, texel_size: float) -> Page:
    """Encode moments (9 or 11, PAGE_HEIGHT + 2 APRON, WIDTH + 2 APRON) as a page."""
    rough = np.sqrt(np.sqrt(moments[lod.ALPHA2]))
    channels = len(moments[lod.F0])
    ends = tuple(
        (float(m.min()), float(m.max())) for m in (moments[lod.F0], rough, moments[lod.HEIGHT])
    )
    parts = []
    for mip in range(MIPS):
        moments = lod.halved(moments) if mip else moments
        albedo, metal = _halves(moments[lod.ALBEDO][:4]), _halves(moments[lod.ALBEDO][4:])
        surface = np.empty((*moments.shape[1:], 4), "<f4")
        surface[..., 0] = moments[lod.ALPHA2]
        surface[..., 1], surface[..., 2] = moments[lod.SLOPE_X], moments[lod.SLOPE_Y]
        # Slope variance: 0 at level 0.
        varies = np.square(moments[lod.SLOPE_X]) + np.square(moments[lod.SLOPE_Y])
        surface[..., 3] = np.maximum(moments[lod.SQUARES] - varies, 0.0)
        parts += [albedo, surface.tobytes(), moments[lod.HEIGHT].astype("<f4").tobytes(), metal]
    return Page(b"".join(parts), texel_size, ends, channels)


def _halves(planes: lod.Planes) -> bytes:
    """Bytes of planes as half floats, channels last; empty for no planes."""
    return np.ascontiguousarray(planes.transpose(1, 2, 0)).astype("<f2").tobytes()


# The photograph of a material.

_LONG_SIDE = 1024
_PHOTOGRAPHS = (
    ".dng", ".jpg", ".jpeg", ".jpe", ".jfif", ".png", ".tif", ".tiff", ".heic", ".avif", ".webp",
    ".exr", ".hdr", *sorted(RAW_SUFFIXES),
)  # fmt: skip


@dataclass(frozen=True)
class EncodedPicture:
    """An encoded image for the browser."""

    data: bytes
    """Bytes of the file."""
    kind: str
    """Media type."""

    @property
    def url(self) -> str:
        """The picture as a data URL."""
        return f"data:{self.kind};base64,{base64.b64encode(self.data).decode()}"


def reference_photograph(
    path: Path, name: str, photo: Path | None = None, material: Material | None = None
) -> EncodedPicture | None:
    """The photograph of a material or map set, rectified where the material has an exemplar.

    Args:
        path: of its file or folder.
        photo: file to use instead of the folder's photograph.
        material: the material; None for a map set.

    Raises:
        MatcapError: the photograph cannot be read.
    """
    folder = path if path.is_dir() else path.parent
    report = read_document(folder / "report.json", "matcap report") or {}
    file = photo or find_photograph(path, name) or reported_photograph(report)
    setup = material.setup if material and material.part(Example) else None
    return browser_picture(file, setup, ToneCurve.of_report(report)) if file else None


def find_photograph(path: Path, name: str) -> Path | None:
    """The photograph in a folder: a file with the material's name, or named photo; or None."""
    folder = path if path.is_dir() else path.parent
    for suffix in _PHOTOGRAPHS:
        for file in (folder / f"{name}{suffix}", folder / f"photo{suffix}"):
            if file.is_file():
                return file
    return None


def reported_photograph(report: Mapping[str, Any]) -> Path | None:
    """The photograph whose path a capture's report has, if it exists."""
    try:
        file = Path(report["photograph"]["path"])
    except (KeyError, TypeError):
        return None
    return file if file.is_file() else None


def browser_picture(
    file: Path, setup: FlashSetup | None = None, tone: ToneCurve | None = None
) -> EncodedPicture:
    """A photograph as a JPEG of at most 1024 pixels a side.

    Args:
        setup: camera and flash, by which it is rectified; None leaves it as it is.
        tone: the tone curve that is removed, as the page renders without one.

    Raises:
        MatcapError: the file is not a photograph that matcap reads.
    """
    photo = load_photo(file, long_side=_LONG_SIDE, noise=False)
    photo = photo if tone is None else photo.linearised(tone)
    linear = photo.pixels
    if setup is not None:
        linear = picture_of(rectify(photo, setup, linear.shape[1])[0])
    # Portrait photographs are read in landscape orientation; maps are upright if setup.turned.
    if photo.turned if setup is None else setup.turned:
        linear = standing(linear)
    return EncodedPicture(jpeg_bytes(linear, 88), "image/jpeg")
