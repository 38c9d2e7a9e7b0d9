"""Input of exporters: a map set, and how it is to be written.

Read next: texture_file.py, which makes files of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from matcap.brdf.maps import COLOURED
from matcap.export.formats import Container, Depth, Picture, bands

if TYPE_CHECKING:
    from torch import Tensor

    from matcap.brdf.maps import MapSet
    from matcap.export.occlusion import Occlusion
    from matcap.export.udim import TextureSet


@dataclass(frozen=True)
class ExportJob:
    """A map set to be exported."""

    maps: MapSet
    """Without batch dimensions."""
    name: str
    """What the files are called; a plain file name."""
    millimetres: float | None = None
    """Physical length of a plane unit; None where it was not measured."""
    depth: Depth | None = None
    """Of all textures, instead of what suits the target."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """How the material was made; any JSON."""
    container: Container | None = None
    """File format of all textures that it suits, instead of the target's own."""
    reach: float | None = None
    """The height, in plane units, that coded heights hold above and below the undisplaced level,
    the same for every realisation; None to find it from these maps."""
    tiled: bool = False
    """EXR files in tiles, with mipmaps."""
    around: MapSet | None = None
    """The same maps with as much around them on every side, where they are a tile of a texture set;
    it is not periodic."""
    tiles: TextureSet | None = None
    """That set, whose first tile this job is; see udim.py."""

    @property
    def unit(self) -> str:
        """Unit of lengths: "mm" or "plane unit"."""
        return "plane unit" if self.millimetres is None else "mm"

    @property
    def unit_length(self) -> float:
        """How many of `unit` a plane unit is."""
        return 1.0 if self.millimetres is None else self.millimetres

    @property
    def metres(self) -> float:
        """How many metres a plane unit is; 1 where it was not measured, as size_notes() says."""
        return 1.0 if self.millimetres is None else self.millimetres / 1000.0

    @property
    def extent(self) -> tuple[float, float]:
        """(width, height) of the map set, or of the whole texture set, in plane units."""
        (width, height), (columns, rows) = self.maps.size, self.grid or (1, 1)
        return columns * width * self.maps.texel_size, rows * height * self.maps.texel_size

    @property
    def grid(self) -> tuple[int, int] | None:
        """(columns, rows) of the texture set; None where there is none."""
        return None if self.tiles is None else (self.tiles.columns, self.tiles.rows)

    @property
    def repeats(self) -> bool:
        """Whether what is exported goes on at its other side."""
        return self.maps.periodic if self.tiles is None else self.tiles.period is not None

    @property
    def wrap(self) -> Literal["periodic", "clamp"]:
        """What lies beyond the border, in the words of texture files."""
        return "periodic" if self.maps.periodic else "clamp"

    def size_notes(self) -> tuple[str, ...]:
        """What users of a target that counts metres must know."""
        if self.millimetres is not None:
            return ()
        width, height = self.extent
        return (f"no real size is known: the plane is {width:.3g} x {height:.3g} m; give --unit",)

    @cached_property
    def diffuse(self) -> Picture:
        """(H, W, 3)."""
        return self._picture(self.maps.diffuse)

    @cached_property
    def specular(self) -> Picture:
        """(H, W) F0; (H, W, 3) where it has a colour."""
        return self._picture(self.maps.specular)

    @property
    def coloured(self) -> bool:
        """Whether F0 has a colour."""
        return self.maps.specular.shape[-3] == COLOURED

    @cached_property
    def roughness(self) -> Picture:
        """(H, W)."""
        return self._picture(self.maps.roughness)

    @cached_property
    def height(self) -> Picture:
        """(H, W), plane units."""
        return self._picture(self.maps.height)

    @cached_property
    def normal(self) -> Picture:
        """(H, W, 3), +Y up."""
        from matcap.brdf.normals import normals_of_rows

        maps = self.around or self.maps
        if maps.painted is not None:
            return self._picture(maps.painted)
        field, (width, height) = maps.height.detach().cpu().float(), maps.size
        made = np.empty((height, width, 3), dtype=np.float32)
        for band in bands(height):
            rows = normals_of_rows(field, maps.texel_size, band, periodic=maps.periodic)
            made[band] = rows.movedim(0, -1).numpy()
        return self._cut(made)

    @cached_property
    def _shadows(self) -> Occlusion:
        from matcap.export.occlusion import occlusion

        maps = self.around or self.maps
        field = self._picture(maps.height) / np.float32(maps.texel_size)
        return occlusion(field, periodic=maps.periodic)

    @cached_property
    def occlusion(self) -> Picture:
        """(H, W) share of an even sky's light that arrives."""
        return self._cut(self._shadows.whole("open"))

    @cached_property
    def cavity(self) -> Picture:
        """(H, W) the same, of the nearest neighbours only."""
        return self._cut(self._shadows.whole("cavity"))

    @cached_property
    def bent(self) -> Picture:
        """(H, W, 3) mean direction of what is open, +Y up."""
        return self._cut(self._shadows.whole("bent"))

    def others(self) -> Iterator[tuple[int, ExportJob]]:
        """(number, job) of every other tile of the texture set whose first tile this job is."""
        if self.tiles is None:
            return
        reach = self.height_code[0] / 2.0
        for number, maps, around in self.tiles.others():
            yield number, replace(self, maps=maps, around=around, reach=reach)

    def _cut(self, wide: Picture) -> Picture:
        """What was made with its surroundings, without them."""
        width, height = self.maps.size
        down, across = (wide.shape[0] - height) // 2, (wide.shape[1] - width) // 2
        return wide[down : down + height, across : across + width]

    @staticmethod
    def _picture(tensor: Tensor) -> Picture:
        pixels: Picture = tensor.detach().cpu().float().movedim(0, -1).squeeze(-1).numpy()
        return pixels

    def picture(self, kind: str) -> Picture:
        """A map as (H, W, 3) or (H, W) float32: diffuse, specular, roughness, height, normal,
        occlusion, cavity or bent.
        """
        values: Picture = getattr(self, kind)
        return values

    def piece(self, rows: slice = slice(None), columns: slice = slice(None)) -> MapRows:
        """Some of the texels; all by default."""
        return MapRows(self, rows, columns)

    @cached_property
    def height_code(self) -> tuple[float, float]:
        """(scale, midlevel): height = (value - midlevel) * scale, scale in plane units.

        The undisplaced level is mid-grey.
        """
        known = (self.around or self.maps).height
        needed = float(known.abs().max()) if known.numel() else 0.0
        # Strengthened relief may leave the material's range; a texture set has one for all tiles.
        fits = self.tiles is not None or needed <= (self.reach or 0.0)
        return 2.0 * (self.reach if self.reach and fits else roomy(needed)), 0.5


@dataclass(frozen=True)
class MapRows:
    """Some texels of a job's maps; each is as it is in the whole."""

    job: ExportJob
    rows: slice
    columns: slice

    def picture(self, kind: str) -> Picture:
        """As ExportJob.picture."""
        return self.job.picture(kind)[self.rows, self.columns]

    @property
    def ones(self) -> Picture:
        """(H, W) of 1."""
        return np.ones_like(self.picture("roughness"))


def known_scale(provenance: Mapping[str, Any]) -> float | None:
    """Millimetres of a plane unit by a material's provenance; None where it has none."""
    card = provenance.get("card")
    for place in (provenance, card if isinstance(card, Mapping) else {}):
        scale = place.get("millimetres_per_unit")
        if isinstance(scale, int | float) and 0.0 < scale < float("inf"):
            return float(scale)
    return None


def roomy(reach: float) -> float:
    """A round number with room above a reach: realisations of one material share it, mostly.

    The next but one of ten steps a decade (Renard's R10), 1 where there is no height.
    """
    if not reach > 0.0:
        return 1.0
    return float(10.0 ** ((np.ceil(10.0 * np.log10(reach) - 1e-9) + 1.0) / 10.0))
