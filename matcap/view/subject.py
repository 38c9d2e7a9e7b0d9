"""Subjects of the page: a material, a blend of two, or a map set."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from pathlib import Path

import numpy as np

from matcap.brdf.folder import read_mapset
from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.example.example import Example
from matcap.export.job import known_scale
from matcap.field.material import Material
from matcap.field.options import AS_IT_IS, ReadOptions
from matcap.field.plane import Rectangle, check_seed
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
        whole = Rectangle(0, 0, *self.maps.size)
        mean = lod.mean_of(self._pyramid.read(0, whole))
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
    path: Path,
    second: Path | None = None,
    seed: int = 0,
    read: ReadOptions = AS_IT_IS,
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
