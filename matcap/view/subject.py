"""What the page looks at: an endless material, two of them with all between, or a map set."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from matcap.errors import UsageError

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet
    from matcap.model.field import Field
    from matcap.model.material import Material
    from matcap.model.source import Generator

_FIELDS = 8  # seeds and shares kept at hand: each is a folded network, a megabyte or so


@dataclass(frozen=True)
class ViewFacts:
    """What the page tells of its subject.

    Attributes:
        name: of the material or map set.
        second: name of the material that it can be blended with, or "".
        texel_size: in plane units; between two materials it lies between theirs.
        period: (width, height) in texels after which it repeats, or None for an endless one.
        seed: the realisation shown first.
    """

    name: str
    second: str
    texel_size: float
    period: tuple[int, int] | None
    seed: int


class Viewable(Protocol):
    """Something that maps of any rectangle can be read from."""

    @property
    def facts(self) -> ViewFacts:
        """What the page tells of it."""
        ...

    def read(self, x: int, y: int, width: int, height: int, *, seed: int, share: float) -> MapSet:
        """The rectangle whose left top texel is (x, y), y downwards.

        Args:
            x, y, width, height: in texels.
            seed: which realisation; a map set has only one.
            share: how far from the first material (0) to the second (1).

        Raises:
            UsageError: a rectangle, seed or share out of range.
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
        self._field = lru_cache(_FIELDS)(self._open)
        self._field(seed, 0.0 if second is None else 0.5)  # what is wrong is told at once

    @property
    def facts(self) -> ViewFacts:
        """See Viewable."""
        second = self.second.name if self.second else ""
        return ViewFacts(self.first.name, second, self.first.texel_size, None, self.seed)

    def read(self, x: int, y: int, width: int, height: int, *, seed: int, share: float) -> MapSet:
        """See Viewable."""
        # One block a call, computed here: the caller decides how many run side by side.
        return self._field(seed, share).read(x, y, width, height, workers=1)

    def _open(self, seed: int, share: float) -> Field:
        from matcap.model.between import blend
        from matcap.model.field import Field

        if self.second is None:
            if share != 0.0:
                raise UsageError(
                    "there is no second material to blend with", remedy="view with --blend"
                )
            return Field(self.first, seed)
        return Field(blend(self.first, self.second, share), seed)


@dataclass(frozen=True)
class Maps:
    """A map set; beyond its borders it repeats.

    Attributes:
        maps: without batch dimensions.
        name: of the set.
    """

    maps: MapSet
    name: str

    @property
    def facts(self) -> ViewFacts:
        """See Viewable."""
        return ViewFacts(self.name, "", self.maps.texel_size, self.maps.size, 0)

    def read(self, x: int, y: int, width: int, height: int, *, seed: int, share: float) -> MapSet:
        """See Viewable."""
        import torch

        if seed != 0 or share != 0.0:
            raise UsageError("a map set has no other seed and no blend", remedy="view a material")
        across, down = self.maps.size
        columns, rows = torch.arange(x, x + width) % across, torch.arange(y, y + height) % down
        # The rectangle is a piece of plane, whose borders do not continue each other.
        cut = self.maps.map(lambda m: m[..., rows, :][..., columns])
        return replace(cut, periodic=False)


def open_subject(
    path: Path,
    second: Path | None = None,
    seed: int = 0,
    generator: Generator | None = None,
) -> Viewable:
    """What a path holds.

    Args:
        path: a .matcap file, a map set's folder or JSON file, or the folder a capture wrote, whose
            material is preferred to its map set.
        second: a material to blend with.
        seed: the realisation shown first.
        generator: "example" or "decoder"; what lies between two materials is the decoder's.

    Raises:
        MatcapError: nothing to open, more than one thing, a broken file, or materials that cannot
            be blended.
        UsageError: a map set was to be blended, or to have another seed.
    """
    from matcap.model.material import Material

    file = _material_in(path)
    if file is not None:
        return Materials(
            Material.load(file).by(generator), Material.load(second) if second else None, seed
        )
    from matcap.brdf.folder import read_mapset

    maps, document = read_mapset(path)
    if second is not None:
        raise UsageError(
            "a map set cannot be blended", where=str(path), remedy="give the .matcap file"
        )
    if seed != 0:
        raise UsageError(
            "a map set has no other seed", where=str(path), remedy="give the .matcap file"
        )
    return Maps(maps, str(document.get("name", path.stem)))


def _material_in(path: Path) -> Path | None:
    if path.suffix.lower() == ".matcap":
        return path
    found = sorted(path.glob("*.matcap")) if path.is_dir() else []
    return found[0] if len(found) == 1 else None
