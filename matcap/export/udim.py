"""Texture sets (UDIM): adjacent tiles, numbered 1001 + column + 10 row from the bottom left.

Each tile is read with a margin, so that normals and occlusion continue across borders. Constants of
a target (index of refraction, height range) are computed from the first tile and used for all. File
names and documents have `<UDIM>` for the number.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from matcap.errors import UsageError
from matcap.export.occlusion import settings
from matcap.field.opened import open_material
from matcap.field.options import AS_IT_IS, ReadOptions
from matcap.files.names import usable_name
from matcap.files.udim import check_grid, tile_number

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet
    from matcap.field.material import Material


@dataclass(frozen=True)
class TextureSet:
    """A grid of tiles of one realisation of a material.

    Raises:
        UsageError: too many tiles, or none.
    """

    material: Material
    """The material, with one generator."""
    columns: int
    """Number of tiles across, 1 to 10."""
    rows: int
    """Number of tiles down, 1 to 900."""
    size: tuple[int, int]
    """(width, height) of a tile in texels."""
    seed: int = 0
    """Seed of the realisation."""

    def __post_init__(self) -> None:
        check_grid(self.columns, self.rows, "--udim")

    @property
    def period(self) -> tuple[int, int] | None:
        """(width, height) of the set in texels, if the material can repeat at that size."""
        whole = self.columns * self.size[0], self.rows * self.size[1]
        return None if any(side % self.material.alignment for side in whole) else whole

    def tile(self, column: int, row: int) -> tuple[MapSet, MapSet]:
        """A tile's maps, and the same with a margin; row 0 is the bottom one."""
        width, height = self.size
        margin = settings(width, height)["reach"]
        wide = self.material.maps(
            width + 2 * margin,
            height + 2 * margin,
            seed=self.seed,
            x=column * width - margin,
            y=(self.rows - 1 - row) * height - margin,  # texels' rows go downwards
            period=self.period,
        )
        wide = replace(wide, periodic=False)
        return wide.crop(margin, margin, width, height), wide

    def others(self) -> Iterator[tuple[int, MapSet, MapSet]]:
        """(UDIM number, maps, maps with a margin) of every tile but the first."""
        for row in range(self.rows):
            for column in range(self.columns):
                if row or column:
                    yield tile_number(column, row), *self.tile(column, row)


def open_set(
    path: Path,
    grid: tuple[int, int],
    size: tuple[int, int],
    seed: int = 0,
    read: ReadOptions = AS_IT_IS,
) -> tuple[TextureSet, str]:
    """Open a material for a texture set; returns the set and the material's name.

    Args:
        path: a material file, or a folder with one.
        grid: (columns, rows).
        size: (width, height) of a tile in texels.

    Raises:
        UsageError: a map set, which cannot be extended; or too many tiles.
        MatcapError: no material, several, or a damaged one.
    """
    if path.suffix.lower() != ".matcap" and not any(path.glob("*.matcap")):
        raise UsageError.at(
            "--udim",
            f"{path} is not a material: only a material has further tiles",
            "give the material (.matcap), or leave out --udim",
        )
    file, material = open_material(path)
    material = material.by(read.generator).varied(read.variety)
    return TextureSet(material, *grid, size, seed), usable_name(file.stem)
