"""Input of exporters: a map set and options. texture_file.py writes textures from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import COLOURED, MapSet, normals_of_rows
from matcap.errors import MatcapError, UsageError
from matcap.export.occlusion import Occlusion, occlusion
from matcap.export.options import Container, ExportOptions
from matcap.field.material import Material

Picture = NDArray[np.float32]
# Rows processed together: with 4096 columns the working set fits the cache.
_BAND_ROWS = 64


def rgb(values: Picture) -> Picture:
    """(H, W, 3): grey (H, W) is repeated."""
    return np.repeat(values[..., None], 3, axis=2) if values.ndim == 2 else values


def brightest_channel(values: Picture) -> Picture:
    """(H, W) maximum over channels of (H, W[, 3])."""
    return values if values.ndim == 2 else values.max(axis=-1)


def mean_channel(values: Picture) -> Picture:
    """(H, W) mean over channels of (H, W[, 3])."""
    return values if values.ndim == 2 else values.mean(axis=-1)


def bands(height: int) -> list[slice]:
    """Slices of _BAND_ROWS rows that cover a picture."""
    return [slice(top, min(top + _BAND_ROWS, height)) for top in range(0, height, _BAND_ROWS)]


@dataclass(frozen=True)
class ExportJob:
    """A map set to export, with the user's options."""

    maps: MapSet
    """Without batch dimensions."""
    name: str
    """Beginning of the files' names; a plain file name."""
    millimetres: float | None = None
    """Physical length of a plane unit; None if it was not measured."""
    options: ExportOptions = ExportOptions()
    """What the user wants in place of the target's defaults."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """Record of how the material was made; JSON."""
    reach: float | None = None
    """Integer heights cover [-reach, reach] plane units, the same for all realisations of a
    material; None is derived from these maps."""

    def check_formats(self, reader: str, containers: Sequence[Container], *, floats: bool) -> None:
        """Raise UsageError for options of textures that a target's files or programs cannot hold.

        Args:
            reader: names them in the error.
            containers: file formats that they can hold.
            floats: whether they can hold half floats and floats.
        """
        wanted = self.options.container
        if not floats and self.options.bits in ("half", "float"):
            raise UsageError.at("--bits", f"{reader} has no float textures", "give 8 or 16")
        if wanted is not None and wanted not in containers:
            remedy = f"give {', '.join(containers[:-1])} or {containers[-1]}"
            raise UsageError.at("--format", f"{reader} cannot hold {wanted}", remedy)

    @property
    def unit(self) -> str:
        """Unit of lengths: "mm" or "plane unit"."""
        return "plane unit" if self.millimetres is None else "mm"

    @property
    def unit_length(self) -> float:
        """Length of a plane unit, in `unit`."""
        return 1.0 if self.millimetres is None else self.millimetres

    @property
    def metres(self) -> float:
        """Length of a plane unit in metres; 1 if it was not measured."""
        return 1.0 if self.millimetres is None else self.millimetres / 1000.0

    @property
    def extent(self) -> tuple[float, float]:
        """(width, height) of the map set in plane units."""
        width, height = self.maps.size
        return width * self.maps.texel_size, height * self.maps.texel_size

    def size_notes(self) -> tuple[str, ...]:
        """Note for targets in metres, if the size was not measured."""
        if self.millimetres is not None:
            return ()
        width, height = self.extent
        return (
            f"the size was not measured: the plane is {width:.3g} x {height:.3g} m; matcap export "
            "--unit sets it, in millimetres of half the photograph's long side",
        )

    @property
    def coloured(self) -> bool:
        """Whether F0 is coloured."""
        return self.maps.specular.shape[-3] == COLOURED

    def picture(self, kind: str) -> Picture:
        """A map, computed once: diffuse, normal and bent (mean unoccluded direction) as (H, W, 3),
        specular (F0) so if it is coloured, roughness, height in plane units, occlusion and cavity
        (occlusion.py) as (H, W). Normals are unit vectors, +Y up.
        """
        if kind not in self._made:
            self._made[kind] = self._picture(kind)
        return self._made[kind]

    @cached_property
    def _made(self) -> dict[str, Picture]:
        return {}

    def _picture(self, kind: str) -> Picture:
        maps = self.maps
        if kind in ("occlusion", "cavity", "bent"):
            return self._shadows.whole("open" if kind == "occlusion" else kind)
        if kind != "normal":
            return _unstacked(getattr(maps, kind))
        if maps.painted is not None:
            return _unstacked(maps.painted)
        field, (width, height) = maps.height.detach().cpu().float(), maps.size
        made = np.empty((height, width, 3), dtype=np.float32)
        for band in bands(height):
            rows = normals_of_rows(field, maps.texel_size, band, periodic=maps.periodic)
            made[band] = rows.movedim(0, -1).numpy()
        return made

    @cached_property
    def _shadows(self) -> Occlusion:
        heights = self.picture("height") / np.float32(self.maps.texel_size)
        return occlusion(heights, periodic=self.maps.periodic)

    def piece(self, rows: slice = slice(None), columns: slice = slice(None)) -> MapRows:
        """The texels of rows and columns; all by default."""
        return MapRows(self, rows, columns)

    @cached_property
    def height_code(self) -> tuple[float, float]:
        """(scale, midlevel): height = (value - midlevel) * scale, scale in plane units.

        The undisplaced level is mid-grey.
        """
        known = self.maps.height
        needed = float(known.abs().max()) if known.numel() else 0.0
        # Adjusted relief may exceed the material's range.
        reach = self.reach if self.reach and needed <= self.reach else roomy(needed)
        return 2.0 * reach, 0.5


def _unstacked(tensor: Tensor) -> Picture:
    return tensor.detach().cpu().float().movedim(0, -1).squeeze(-1).numpy()


@dataclass(frozen=True)
class MapRows:
    """A rectangle of a job's maps, computed from the whole."""

    job: ExportJob
    rows: slice
    columns: slice

    def picture(self, kind: str) -> Picture:
        """Picture of a map of these rows (ExportJob.picture)."""
        return self.job.picture(kind)[self.rows, self.columns]


def known_scale(provenance: Mapping[str, Any]) -> float | None:
    """Millimetres of a plane unit, from a material's provenance; None if not measured."""
    card = provenance.get("card")
    for place in (provenance, card if isinstance(card, Mapping) else {}):
        scale = place.get("millimetres_per_unit")
        if isinstance(scale, int | float) and 0.0 < scale < float("inf"):
            return float(scale)
    return None


def roomy(reach: float) -> float:
    """Round a height range up to the next but one of ten values a decade; 0 gives 1.

    With that room most realisations of a material share one value.
    """
    if not reach > 0.0:
        return 1.0
    return float(10.0 ** ((np.ceil(10.0 * np.log10(reach) - 1e-9) + 1.0) / 10.0))


def material_reach(path: Path, name: str) -> float | None:
    """Largest absolute height that coded heights hold, in plane units (ExportJob.reach).

    That of the exemplar, which every realisation rearranges, rounded up (roomy).

    Args:
        path: a material, or the JSON document or folder of a map set.
        name: of the map set; its material is NAME.matcap in the same folder.

    Returns:
        None without a material that has an exemplar.
    """
    folder = path if path.is_dir() else path.parent
    file = path if path.suffix.lower() == ".matcap" else folder / f"{name}.matcap"
    piece = None
    if file.is_file():
        # The maps have been read; a damaged material in their folder is ignored.
        with suppress(MatcapError):
            piece = Material.load(file).generator.piece()
    if piece is None:
        return None
    return roomy(float(piece.height.abs().amax()))
