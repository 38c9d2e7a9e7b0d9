"""Open what a user names: a material, a map set, or a folder with either.

A folder stands for its only material; without one, or with several, for its map set.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matcap.brdf.adjust import KEY, Adjustments, adjusted
from matcap.brdf.folder import SETUP, find_mapsets, read_mapset
from matcap.errors import MatcapError, UsageError
from matcap.field.options import AS_IT_IS, ReadOptions
from matcap.files.names import usable_name
from matcap.files.settings import refuse_options

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet
    from matcap.field.material import Material
    from matcap.flash.geometry import FlashSetup

# Provenance entry of maps that are the exemplar itself, made to repeat.
REPEATS = {"tile": "piece"}


def refuse_with_piece(given: Mapping[str, object]) -> None:
    """Raise UsageError for the first option given together with `--tile piece`."""
    refuse_options(
        {f"{option} with --tile piece": value for option, value in given.items()},
        "the periodic exemplar is one map set of fixed size, without a seed",
        "leave one of the two out",
    )


@dataclass(frozen=True)
class OpenedMaps:
    """Maps with their name and provenance."""

    maps: MapSet
    """Without batch dimensions."""
    name: str
    """Name of the map set or the material."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Record of how the material was made; JSON."""


def open_tile(
    path: Path,
    read: ReadOptions = AS_IT_IS,
    *,
    size: tuple[int, int] | None = None,
    seed: int | None = None,
    piece: bool = False,
) -> OpenedMaps:
    """Maps of a material file, a map set's JSON file, or a folder.

    A material's maps are periodic where both sides are multiples of its alignment, in general 16
    texels.

    Args:
        path: of the file or folder.
        read: options of reading; adjustments are recorded in the provenance.
        size: (width, height) in texels of a material's maps; None is 1024 x 1024.
        seed: of a material's realisation; None is 0.
        piece: return the exemplar itself as a seamless tile.

    Raises:
        UsageError: `normals` with a material; size, seed, generator, variety or piece with a map
            set.
        MatcapError: nothing to open, more than one thing, or a broken file.
    """
    path = _resolved(path)
    adjust = read.adjustments
    if path.suffix.lower() == ".matcap":
        material = _material(path, read)
        name, provenance = usable_name(path.stem), dict(material.provenance)
        if piece:
            maps, provenance = material.repeating(), provenance | REPEATS
        else:
            size, repeat = size or (1024, 1024), material.alignment
            period = None if size[0] % repeat or size[1] % repeat else size
            maps = material.maps(*size, seed=seed or 0, period=period)
    else:
        given: dict[str, object] = {"--size": size, "--seed": seed, "--generator": read.generator}
        given |= {"--variety": read.variety, "--tile piece": piece or None}
        _refuse_of_material(path, given)
        maps, document = read_mapset(path, read.normals or "height")
        name, provenance = document["name"], document["provenance"]
    if adjust.changes:
        before = provenance.get(KEY)
        provenance[KEY] = f"{before}; {adjust.text}" if before else adjust.text
    return OpenedMaps(adjusted(maps, adjust), name, provenance)


def _refuse_of_material(path: Path, given: Mapping[str, object]) -> None:
    """Raise UsageError for the first option that is given with the map set at a path."""
    for option in (option for option, asked in given.items() if asked is not None):
        what = f"this is a map set ({path}), where this is fixed"
        raise UsageError.at(option, what, "give the material (.matcap), or leave it out")


@dataclass(frozen=True)
class PhotographedAs:
    """Camera, flash and size of a material's photograph."""

    setup: FlashSetup
    size: tuple[int, int] | None
    """(width, height) in texels of the exemplar if it covers exactly the photograph, else None."""
    endless: bool
    """Whether maps of other places exist: true for a material, false for a map set."""


def open_photographed(path: Path) -> PhotographedAs | None:
    """How the material or map set at a path was photographed.

    None for a map set whose provenance has no setup: only the exemplar's own has one.

    Raises:
        MatcapError: as open_source.
    """
    from matcap.field.header import stated_setup
    from matcap.flash.geometry import FlashSetup

    path = _resolved(path)
    if path.suffix.lower() == ".matcap":
        material = _material(path)
        size = material.generator.piece_size
        # A mosaic of several photographs is larger than one of them.
        long = 1 if material.setup.turned else 0
        own = size is not None and size[long] == round(2.0 / material.texel_size)
        return PhotographedAs(material.setup, size if own else None, endless=True)
    maps, document = read_mapset(path)
    try:
        setup = FlashSetup(**stated_setup(document["provenance"][SETUP]))
    except (KeyError, TypeError, ValueError):
        return None
    return PhotographedAs(setup, maps.size, endless=False)


def material_file(path: Path) -> Path:
    """Path of a material's file: the path itself, or the only material of a folder.

    Raises:
        MatcapError: no material there, or several.
    """
    resolved = _resolved(path)
    if resolved.is_dir() or resolved.suffix.lower() == ".json":
        raise MatcapError.at(
            path,
            "this is a map set, from which no more can be synthesised",
            "give the material (.matcap)",
        )
    return resolved


def open_material(path: Path) -> tuple[Path, Material]:
    """Load a material from its file or folder; return the file's path, too.

    Raises:
        MatcapError: no material there, several, or a broken one.
    """
    path = _resolved(path)
    return path, _material(path)


@dataclass(frozen=True)
class AdjustedMaterial:
    """A material whose maps are adjusted as they are read."""

    material: Material
    adjust: Adjustments

    @property
    def texel_size(self) -> float:
        """Side of a texel, plane units."""
        return self.material.texel_size

    def maps(self, width: int, height: int, *, seed: int = 0, x: int = 0, y: int = 0) -> MapSet:
        """Maps of a rectangle of the endless field (Material.maps), with adjustments."""
        return adjusted(self.material.maps(width, height, seed=seed, x=x, y=y), self.adjust)


def open_source(path: Path, read: ReadOptions = AS_IT_IS) -> MapSet | Material | AdjustedMaterial:
    """Open a map set's maps or a material, with the read options applied.

    Raises:
        UsageError: as open_tile.
        MatcapError: nothing to open, more than one thing, or a broken file.
    """
    path, adjust = _resolved(path), read.adjustments
    if path.suffix.lower() != ".matcap":
        _refuse_of_material(path, {"--variety": read.variety})
        return adjusted(read_mapset(path, read.normals or "height")[0], adjust)
    material = _material(path, read)
    return AdjustedMaterial(material, adjust) if adjust.changes else material


def _resolved(path: Path) -> Path:
    """The path of a file; of a folder its only material, else the folder if it has a map set."""
    if not path.is_dir():
        return path
    materials = sorted(path.glob("*.matcap"))
    if len(materials) == 1:
        return materials[0]
    if find_mapsets(path):
        return path
    if materials:
        names = ", ".join(file.name for file in materials)
        raise MatcapError.at(
            path,
            f"there are {len(materials)} materials in this folder ({names})",
            "name one of them",
        )
    raise MatcapError.at(
        path,
        "there is no map set and no material in this folder",
        "give a folder that matcap capture or matcap synth wrote",
    )


def _material(path: Path, read: ReadOptions = AS_IT_IS) -> Material:
    """The material of a file, by its generator and of the variety asked for."""
    from matcap.field.material import Material

    if read.normals is not None:
        raise UsageError.at(
            "--normals",
            f"this is a material ({path}), whose normals follow from its heights",
            "give a map set, or leave it out",
        )
    return Material.load(path).by(read.generator).varied(read.variety)
