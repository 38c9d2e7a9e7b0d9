"""Subjects of the page: a material, a blend of two, or a map set."""

from __future__ import annotations

import base64
import io
import os
from collections import OrderedDict
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from PIL import Image

from matcap.brdf.folder import read_mapset
from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.example.example import Example, halved
from matcap.export.job import known_scale
from matcap.field.material import Material
from matcap.field.options import AS_IT_IS, ReadOptions
from matcap.field.plane import COORDINATE_LIMIT, Rectangle, check_seed
from matcap.files.color import srgb_picture
from matcap.files.names import read_document
from matcap.files.pixels import quantised
from matcap.flash.geometry import FlashSetup
from matcap.flash.rectify import picture_of, rectify
from matcap.photo.load import RAW_SUFFIXES, load_photo
from matcap.photo.photo import ToneCurve, standing
from matcap.view import level_of_detail as lod
from matcap.view.level_of_detail import ExampleLevels, ExemplarAverages, NetworkLevels, Planes

_FIELDS = 8  # fields cached, by seed and share; and blends, by share


@dataclass(frozen=True)
class ViewFacts:
    """Description of a subject for the page."""

    name: str
    """Name of the material or map set."""
    second: str
    """Name of the material that it can be blended with, or ""."""
    texel_size: float
    """Side of a texel of the first material, in plane units."""
    period: tuple[int, int] | None
    """(width, height) in texels, or None for an endless field."""
    seed: int
    """Seed of the realisation shown first."""
    mean: tuple[float, ...]
    """Mean moments (level_of_detail.py), shown until pages arrive."""
    piece: tuple[int, int] | None = None
    """(width, height) of the exemplar in texels, where the photograph is shown; or None."""
    millimetres: float = 0.0
    """Length of a plane unit; 0 if unknown."""


class Materials:
    """A material, or two and their blends.

    Args:
        first: the material.
        second: to compare and blend with, or None.
        seed: of the realisation shown first.

    Raises:
        UsageError: the seed is out of range.
    """

    def __init__(self, first: Material, second: Material | None = None, seed: int = 0) -> None:
        self.first, self.second, self.seed = first, second, seed
        self._blended = lru_cache(_FIELDS)(self._blend)
        self._averages = lru_cache(_FIELDS)(self._averages_at)
        self._field = lru_cache(_FIELDS)(self._open)
        self._field(seed, 0.0)  # to raise errors here

    @property
    def facts(self) -> ViewFacts:
        """Description for the page."""
        second = self.second.name if self.second else ""
        return ViewFacts(
            self.first.name, second, self.first.texel_size, None, self.seed, self._mean,
            self.first.generator.piece_size, known_scale(self.first.provenance) or 0.0,
        )  # fmt: skip

    def at(self, share: float) -> Material:
        """The blend of both materials at a share of the second.

        Raises:
            UsageError: there is no second material.
        """
        return self._blended(share)

    def _blend(self, share: float) -> Material:
        if self.second is not None:
            from matcap.space.between import blend  # loads the decoder's rooms, and torch

            return blend(self.first, self.second, share)
        if share != 0.0:
            raise UsageError(
                "there is no second material to blend with", remedy="view with --blend"
            )
        return self.first

    @cached_property
    def _mean(self) -> tuple[float, ...]:
        example = self.first.part(Example)
        if example is None:
            return lod.mean_of(NetworkLevels.of(self.first, self.seed).mean)
        exemplar = example.exemplar
        return lod.mean_of(lod.moments_of(lod.edged(exemplar.stacked()), exemplar.texel_size))

    def moments(
        self, level: int, area: Rectangle, *, seed: int, share: float
    ) -> tuple[Planes, float]:
        """(9 or 11, height, width) moments of an area (level_of_detail.py), and the texel size.

        Args:
            level: texels are 2^level texels of the material wide.
            area: in texels of the level.
            seed: of the realisation.
            share: of the second material, in [0, 1].

        Raises:
            UsageError: a seed or share out of range.
        """
        field = self._field(seed, share)
        return field.read(level, area), field.texel_size

    def _open(self, seed: int, share: float) -> ExampleLevels | NetworkLevels:
        check_seed(seed)
        material = self.at(share)
        example = material.part(Example)
        if example is None:
            return NetworkLevels.of(material, seed)
        return ExampleLevels(example, seed, partial(self._averages, share))

    def _averages_at(self, share: float) -> ExemplarAverages:
        """Averages of the exemplar at a share, shared by all seeds."""
        example = self.at(share).part(Example)
        assert example is not None
        return ExemplarAverages(example.exemplar)


@dataclass(frozen=True)
class Maps:
    """A map set, repeated beyond its borders."""

    maps: MapSet
    """Without batch dimensions."""
    name: str
    """Name of the map set."""

    @property
    def facts(self) -> ViewFacts:
        """Description for the page."""
        mean = lod.mean_of(self._pyramid.read(0, Rectangle(0, 0, *self.maps.size)))
        return ViewFacts(self.name, "", self.maps.texel_size, self.maps.size, 0, mean)

    def moments(
        self, level: int, area: Rectangle, *, seed: int, share: float
    ) -> tuple[Planes, float]:
        """Moments of an area, and the texel size, as those of Materials; seed and share are 0."""
        if seed != 0 or share != 0.0:
            raise UsageError("a map set has no other seed and no blend", remedy="view a material")
        return self._pyramid.read(level, area), self.maps.texel_size

    @cached_property
    def _pyramid(self) -> lod.Pyramid:
        around = ((0, 0), (lod.RING, lod.RING), (lod.RING, lod.RING))
        wrapped = np.pad(self.maps.stacked().numpy(), around, mode="wrap")
        return lod.Pyramid(lod.moments_of(wrapped, self.maps.texel_size))


Viewable = Materials | Maps


def open_subject(
    path: Path, second: Path | None = None, seed: int = 0, read: ReadOptions = AS_IT_IS
) -> Viewable:
    """Open a material or map set for the page.

    Args:
        path: a .matcap file, a map set's folder or JSON file, or a capture's folder, whose material
            is preferred to its map set.
        second: a material to blend with.

    Raises:
        MatcapError: nothing to open, more than one thing, a broken file, or materials that cannot
            be blended.
        UsageError: a second material, seed or variety with a map set.
    """
    file = _material_in(path)
    if file is not None:
        first = Material.load(file).by(read.generator).varied(read.variety)
        if second is None:
            return Materials(first, None, seed)
        from matcap.space.between import check_blendable

        other = Material.load(second)
        check_blendable(first, other)
        return Materials(first, other, seed)
    maps, document = read_mapset(path)
    if second is not None:
        raise UsageError.at(path, "a map set cannot be blended", "give the .matcap file")
    if read.variety is not None:
        raise UsageError.at("--variety", "a map set has no patches", "give the .matcap file")
    if seed != 0:
        raise UsageError.at(path, "a map set has no other seed", "give the .matcap file")
    return Maps(maps, str(document.get("name", path.stem)))


def _material_in(path: Path) -> Path | None:
    if path.suffix.lower() == ".matcap":
        return path
    files = sorted(path.glob("*.matcap")) if path.is_dir() else []
    return files[0] if len(files) == 1 else None


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
        page = Rectangle(self.column * WIDTH, self.row * PAGE_HEIGHT, WIDTH, PAGE_HEIGHT)
        return page.grown(APRON)


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
    shown = (moments[lod.F0], rough, moments[lod.HEIGHT])
    ends = tuple((float(each.min()), float(each.max())) for each in shown)
    parts = []
    for mip in range(MIPS):
        moments = halved(moments) if mip else moments
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

_LONG_SIDE, _JPEG_QUALITY = 1024, 88
_PHOTOGRAPHS = (
    ".dng", ".jpg", ".jpeg", ".jpe", ".jfif", ".png", ".tif", ".tiff", ".heic", ".avif", ".webp",
    ".exr", ".hdr", *sorted(RAW_SUFFIXES),
)  # fmt: skip


@dataclass(frozen=True)
class EncodedPicture:
    """An encoded image for the browser."""

    data: bytes
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
    jpeg = io.BytesIO()
    codes = quantised(srgb_picture(linear), bits=8)
    Image.fromarray(codes).save(jpeg, "JPEG", quality=_JPEG_QUALITY)
    return EncodedPicture(jpeg.getvalue(), "image/jpeg")
