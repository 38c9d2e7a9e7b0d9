"""A texture set: tiles of one piece of material, numbered 1001 from the left bottom on (UDIM).

Every tile is realised by itself, with some of what lies around it, so that normals and occlusion go
on over its borders. What a target needs of the whole (an index of refraction, a range of heights)
is found from the first tile and holds for all. File names and documents say `<UDIM>`.
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

if TYPE_CHECKING:
    from matcap.brdf.maps import MapSet
    from matcap.field.material import Material

FIRST = 1001
MOST_COLUMNS, MOST_ROWS = 10, 900


@dataclass(frozen=True)
class TextureSet:
    """Which tiles there are, and of what.

    Raises:
        UsageError: too many tiles, or none.
    """

    material: Material
    """By one generator."""
    columns: int
    """At most MOST_COLUMNS."""
    rows: int
    """At most MOST_ROWS."""
    size: tuple[int, int]
    """(width, height) of a tile in texels."""
    seed: int = 0
    """Which realisation."""

    def __post_init__(self) -> None:
        if not (1 <= self.columns <= MOST_COLUMNS and 1 <= self.rows <= MOST_ROWS):
            raise UsageError(
                f"a texture set of {self.columns}x{self.rows} tiles",
                where="--udim",
                remedy=f"ask for at most {MOST_COLUMNS} columns and {MOST_ROWS} rows",
            )

    @property
    def period(self) -> tuple[int, int] | None:
        """Of the whole set in texels; None where its sides do not allow one."""
        whole = self.columns * self.size[0], self.rows * self.size[1]
        return None if any(side % self.material.alignment for side in whole) else whole

    def tile(self, column: int, row: int) -> tuple[MapSet, MapSet]:
        """(a tile's maps, the same with their surroundings); rows are counted upwards."""
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

    @property
    def numbers(self) -> list[int]:
        """Of all tiles, left to right, the lowest row first."""
        return numbers_of(self.columns, self.rows)

    def others(self) -> Iterator[tuple[int, MapSet, MapSet]]:
        """(number, maps, the same with their surroundings) of every tile but the first."""
        for row in range(self.rows):
            for column in range(self.columns):
                if row or column:
                    yield FIRST + column + 10 * row, *self.tile(column, row)


def numbers_of(columns: int, rows: int) -> list[int]:
    """The numbers of a texture set's tiles, left to right, the lowest row first."""
    grid = ((column, row) for row in range(rows) for column in range(columns))
    return [FIRST + column + 10 * row for column, row in grid]


def open_set(
    path: Path,
    grid: tuple[int, int],
    size: tuple[int, int],
    seed: int = 0,
    read: ReadOptions = AS_IT_IS,
) -> tuple[TextureSet, str]:
    """A texture set of a material file, or of a folder's one material, and its name.

    Args:
        path: what to open.
        grid: (columns, rows).
        size: (width, height) of a tile in texels.
        seed: which realisation.
        read: which of its fields.

    Raises:
        UsageError: a map set, which has one tile; or too many tiles.
        MatcapError: no material there, several, or a broken one.
    """
    if path.suffix.lower() != ".matcap" and not any(path.glob("*.matcap")):
        raise UsageError(
            f"{path} is no material, of which there are tiles",
            where="--udim",
            remedy="give the material (.matcap), or leave it out",
        )
    file, material = open_material(path)
    material = material.by(read.generator).varied(read.variety)
    return TextureSet(material, *grid, size, seed), usable_name(file.stem)
