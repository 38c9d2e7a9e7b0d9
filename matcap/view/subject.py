"""Subjects of the page: a material, a blend of two, or a map set."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from matcap.errors import UsageError
from matcap.example.example import Example
from matcap.field.options import AS_IT_IS, ReadOptions
from matcap.field.plane import Rectangle

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet
    from matcap.field.material import Material
    from matcap.flash.geometry import FlashSetup
    from matcap.view.level_of_detail import ExampleLevels, NetworkLevels, Pyramid, SmallerForms
    from matcap.view.moments import Planes

_FIELDS = 8  # seeds and shares kept at hand: each is a folded network, a megabyte or so


@dataclass(frozen=True)
class Flashed:
    """Camera and flash of the photograph, in the plane of its piece (flash/geometry.py).

    The piece is two plane units wide, and its middle is their origin.
    """

    camera: tuple[float, ...]
    """Its place."""
    light: tuple[float, ...]
    """Place of the flash."""
    axis: tuple[float, ...]
    """Where the camera looks, a unit vector."""
    intensity: tuple[float, float, float]
    """Radiant intensity of the flash, by channel."""
    vignetting: tuple[float, float]
    """(a, b), light is lost by exp(-a tan^2 - b tan^4) at an angle from the axis."""


@dataclass(frozen=True)
class ViewFacts:
    """What the page shows about its subject."""

    name: str
    """Of the material or map set."""
    second: str
    """Name of the material that it can be blended with, or ""."""
    texel_size: float
    """In plane units; between two materials it lies between theirs."""
    period: tuple[int, int] | None
    """(width, height) in texels after which it repeats, or None for an endless one."""
    seed: int
    """The realisation shown first."""
    mean: tuple[float, ...]
    """Moments (moments.py) of a texel like all together, shown before there is any."""
    piece: tuple[int, int] | None = None
    """(width, height) in texels of the photographed piece, where it is known."""
    flash: Flashed | None = None
    """What it was photographed with."""
    millimetres: float = 0.0
    """Of a plane unit; 0 where it was not measured."""


class Viewable(Protocol):
    """Something that can be seen anywhere, from near and far."""

    @property
    def facts(self) -> ViewFacts:
        """What the page shows about it."""
        ...

    def moments(
        self, level: int, area: Rectangle, *, seed: int, share: float, piece: bool = False
    ) -> tuple[Planes, float]:
        """(9 or 11, height, width) moments of an area (moments.py); a texel's side in plane units.

        Args:
            level: a texel of it is 2^level texels of the material wide.
            area: in texels of the level, y downwards.
            seed: which realisation; a map set has only one.
            share: how far from the first material (0) to the second (1).
            piece: of the photographed piece instead, which has no seed.

        Raises:
            UsageError: a seed or share out of range.
        """
        ...


class Materials:
    """One material, or two and all between them.

    Args:
        first: the material.
        second: what it can be blended with.
        seed: the realisation shown first.

    Raises:
        MatcapError: the two cannot be blended.
        UsageError: the seed is out of range.
    """

    def __init__(self, first: Material, second: Material | None = None, seed: int = 0) -> None:
        self.first, self.second, self.seed = first, second, seed
        self._prepared: dict[int, Callable[[], SmallerForms]] = {}
        self._field = lru_cache(_FIELDS)(self._open)
        self._field(seed, 0.0 if second is None else 0.5)  # errors are raised at once

    @property
    def facts(self) -> ViewFacts:
        """See Viewable."""
        second = self.second.name if self.second else ""
        size = self.first.texel_size
        piece = self.first.generator.piece_size
        return ViewFacts(
            self.first.name, second, size, None, self.seed, self._mean,
            piece, _flashed(self.first.setup) if piece else None,
            _millimetres(self.first.provenance),
        )  # fmt: skip

    def at(self, share: float) -> Material:
        """The material between the two.

        Raises:
            UsageError: there is no second one.
        """
        if self.second is not None:
            from matcap.space.between import blend

            return blend(self.first, self.second, share)
        if share != 0.0:
            raise UsageError(
                "there is no second material to blend with", remedy="view with --blend"
            )
        return self.first

    @cached_property
    def _piece(self) -> Pyramid:
        from matcap.view.level_of_detail import Pyramid
        from matcap.view.moments import edged, moments_of

        example = self.first.part(Example)
        if example is None:
            raise _no_piece()
        exemplar = example.exemplar
        return Pyramid(moments_of(edged(exemplar.stacked()), exemplar.texel_size))

    @cached_property
    def _mean(self) -> tuple[float, ...]:
        from matcap.view.level_of_detail import NetworkLevels
        from matcap.view.moments import mean_of

        piece = self.first.generator.piece_size
        if piece is None:
            return mean_of(NetworkLevels.of(self.first, self.seed).mean)
        return mean_of(self._piece.read(0, Rectangle(0, 0, *piece)))

    def moments(
        self, level: int, area: Rectangle, *, seed: int, share: float, piece: bool = False
    ) -> tuple[Planes, float]:
        """See Viewable."""
        if piece:
            return self._piece.read(level, area), self.first.texel_size
        field = self._field(seed, share)
        return field.read(level, area), field.texel_size

    def _open(self, seed: int, share: float) -> ExampleLevels | NetworkLevels:
        from matcap.field.plane import check_seed
        from matcap.view.level_of_detail import ExampleLevels, NetworkLevels

        check_seed(seed)
        material = self.at(share)
        example = material.part(Example)
        if example is None:
            return NetworkLevels.of(material, seed)
        return ExampleLevels(example, seed, self._forms(example))

    def _forms(self, example: Example) -> Callable[[], SmallerForms]:
        """Made when they are asked for, and once."""
        from matcap.view.level_of_detail import SmallerForms

        # Two materials have two exemplars at most.
        key = id(example)
        if key not in self._prepared:
            self._prepared[key] = cache(lambda: SmallerForms(example.exemplar))
        return self._prepared[key]


@dataclass(frozen=True)
class Maps:
    """A map set; beyond its borders it repeats."""

    maps: MapSet
    """Without batch dimensions."""
    name: str
    """Of the set."""

    @property
    def facts(self) -> ViewFacts:
        """See Viewable."""
        from matcap.view.moments import mean_of

        whole = Rectangle(0, 0, *self.maps.size)
        mean = mean_of(self._pyramid.read(0, whole))
        return ViewFacts(self.name, "", self.maps.texel_size, self.maps.size, 0, mean)

    def moments(
        self, level: int, area: Rectangle, *, seed: int, share: float, piece: bool = False
    ) -> tuple[Planes, float]:
        """See Viewable."""
        if piece:
            raise _no_piece()
        if seed != 0 or share != 0.0:
            raise UsageError("a map set has no other seed and no blend", remedy="view a material")
        return self._pyramid.read(level, area), self.maps.texel_size

    @cached_property
    def _pyramid(self) -> Pyramid:
        from matcap.view.level_of_detail import from_maps

        return from_maps(self.maps.stacked().numpy(), self.maps.texel_size)


def _no_piece() -> UsageError:
    return UsageError("there is no photographed piece", remedy="view a material that has one")


def _flashed(setup: FlashSetup) -> Flashed:
    from matcap.flash.geometry import camera_in_plane, setup_rotation, stood
    from matcap.flash.light import CORNER_SQUARED

    camera, light = (tuple(stood(setup, place).tolist()) for place in camera_in_plane(setup))
    axis = tuple(stood(setup, -setup_rotation(setup)[2]).tolist())
    # There it is stated of image coordinates: distance times the tangent.
    scale = setup.distance**2 / CORNER_SQUARED
    lost = (setup.vignetting * scale, setup.vignetting_quartic * scale**2)
    return Flashed(camera, light, axis, setup.intensity, lost)


def _millimetres(provenance: Mapping[str, Any]) -> float:
    from matcap.export.job import known_scale

    return known_scale(provenance) or 0.0


def open_subject(
    path: Path,
    second: Path | None = None,
    seed: int = 0,
    read: ReadOptions = AS_IT_IS,
) -> Viewable:
    """What a path holds.

    Args:
        path: a .matcap file, a map set's folder or JSON file, or the folder a capture wrote, whose
            material is preferred to its map set.
        second: a material to blend with.
        seed: the realisation shown first.
        read: of the first one; what lies between two materials is the decoder's.

    Raises:
        MatcapError: nothing to open, more than one thing, a broken file, or materials that cannot
            be blended.
        UsageError: a map set was to be blended, or to have another seed.
    """
    from matcap.field.material import Material

    file = _material_in(path)
    if file is not None:
        first = Material.load(file).by(read.generator).varied(read.variety)
        return Materials(first, Material.load(second) if second else None, seed)
    from matcap.brdf.folder import read_mapset

    maps, document = read_mapset(path)
    if second is not None:
        raise UsageError(
            "a map set cannot be blended", where=str(path), remedy="give the .matcap file"
        )
    if read.variety is not None:
        raise UsageError(
            "a map set has no pieces", where="--variety", remedy="give the .matcap file"
        )
    if seed != 0:
        raise UsageError(
            "a map set has no other seed", where=str(path), remedy="give the .matcap file"
        )
    return Maps(maps, str(document.get("name", path.stem)))


def _material_in(path: Path) -> Path | None:
    if path.suffix.lower() == ".matcap":
        return path
    files = sorted(path.glob("*.matcap")) if path.is_dir() else []
    return files[0] if len(files) == 1 else None
