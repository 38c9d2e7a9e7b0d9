"""The by-example generator: an exemplar with its index.

Places are synthesised on a grid of at most _GRID texels. A larger exemplar is halved to that grid
for the synthesis, and its maps are read at full resolution.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import cached_property
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matcap.brdf.stated import NormalStyle
from matcap.example.blend import Band, ExemplarBands, Votes, bands_of, blended, seam_correlations
from matcap.example.coordinates import coordinates
from matcap.example.correction import Places
from matcap.example.exemplar import Exemplar, Floats
from matcap.example.grids import frame_of, level_count
from matcap.example.index import Index, build_index
from matcap.example.lattice import GRID, Frequency
from matcap.example.lookup import Lookup, kept_lattice, prepare
from matcap.example.normals import with_normals
from matcap.example.patch_sizes import PatchSizes
from matcap.example.repeat.source import BLOCKS, RepeatedSource
from matcap.field.blocks import RING, Grid
from matcap.field.plane import Period, Rectangle, check_period, check_seed, check_variety
from matcap.files.values import bounded

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from matcap.brdf.maps import MapSet

_MEASURED = (1, 128)  # level, and places a side, of the square of seam_correlations
_GRID = 1536  # texels of the grid's longer side, at most


@dataclass(frozen=True)
class _Ready:
    """Data computed from an example at its first use."""

    lookup: Lookup
    """Tables for the synthesis of places."""
    shown: ExemplarBands
    """Bands from which the maps at those places are blended."""


_PREPARING = Lock()


@dataclass(frozen=True)
class Example:
    """An exemplar and its index; picklable."""

    exemplar: Exemplar
    """Rounded as in a file (Exemplar.rounded)."""
    index: Index
    """Index of the exemplar on its grid."""
    variety: float = 1.0
    """Patch size, from 0, the whole exemplar, to 1, the smallest patches."""

    @staticmethod
    def of(exemplar: Exemplar, waves: tuple[Frequency, ...] = ()) -> Example:
        """Index an exemplar.

        Args:
            exemplar: of at least 14 texels a side.
            waves: approximate frequency vectors of its lattice, cycles per texel; or none.

        Raises:
            ValueError: it is too small.
        """
        return Example.of_rounded(exemplar.rounded(), waves)

    @staticmethod
    def of_rounded(
        exemplar: Exemplar, waves: tuple[Frequency, ...] = (), *, straight: bool = False
    ) -> Example:
        """Index an exemplar that is rounded as in a file; arguments and errors of `of`.

        With `straight`, waves are exact and the lattice has no bend.
        """
        bits = detail_bits(exemplar)
        coarse = coarsened(exemplar, bits)
        if not level_count(*coarse.size):
            raise ValueError(f"an exemplar of {exemplar.size} texels")
        scaled = tuple((fx * 2**bits, fy * 2**bits) for fx, fy in waves)
        return Example(exemplar, build_index(coarse, scaled, straight=straight))

    @property
    def alignment(self) -> int:
        """Texels: periods of its field are multiples of this."""
        return 1 << (detail_bits(self.exemplar) + len(self.index.bases) - 1)

    @property
    def piece_size(self) -> tuple[int, int]:
        """(width, height) of the exemplar in texels."""
        return self.exemplar.size

    def piece(self) -> MapSet:
        """Maps of the exemplar."""
        import torch

        from matcap.brdf.maps import MapSet

        return MapSet.from_stacked(
            torch.from_numpy(self.exemplar.stacked()), self.exemplar.texel_size
        )

    def source(
        self, seed: int, period: Period | None = None, device: torch.device | None = None
    ) -> ExampleSource:
        """The field of a seed and period, computed on the processor whatever the device.

        Raises:
            UsageError: a seed or period out of range.
        """
        check_seed(seed)
        check_period(period, self.alignment)
        return ExampleSource(self, seed, period, self.exemplar.texel_size)

    def repeating(self) -> MapSet:
        """Maps of the exemplar as a seamless tile; see example/repeat.

        Raises:
            UsageError: it is too small.
        """
        import torch

        from matcap.brdf.maps import MapSet

        stacked = torch.from_numpy(self.repeating_source().stacked)
        return MapSet.from_stacked(stacked, self.exemplar.texel_size, periodic=True)

    def repeating_source(self) -> RepeatedSource:
        """repeating() as a source; needs no PyTorch.

        Raises:
            UsageError: it is too small.
        """
        # Imports OpenCV, which takes a tenth of a second and only tiles need.
        from matcap.example.repeat.repeat import repeated

        exemplar, lattice = self.exemplar, self.index.lattice
        bits = detail_bits(exemplar)
        box = known_part(exemplar, 1 << (GRID + bits))
        rows, columns = slice(box.y, box.y + box.height), slice(box.x, box.x + box.width)
        within = lattice and lattice.cropped(box.x >> bits, box.y >> bits)
        maps = exemplar.stacked()[:, rows, columns]
        return RepeatedSource(
            repeated(maps, exemplar.texel_size, within, bits).maps, exemplar.texel_size
        )

    def stored(self) -> tuple[dict[str, NDArray[np.uint8]], dict[str, Any]]:
        """Tensors, and a description for JSON; the inverse of read()."""
        maps, about = self.exemplar.stored()
        chosen, about_index = self.index.stored()
        tensors = {f"exemplar.{name}": data for name, data in maps.items()}
        tensors |= {f"index.{name}": data for name, data in chosen.items()}
        described: dict[str, Any] = {"exemplar": about, "index": about_index}
        # A file without a variety has variety 1.
        return tensors, described | ({} if self.variety == 1.0 else {"variety": self.variety})

    def in_file(self, entry: str = "example") -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Tensors and an entry of a material's description; the inverse of stored.example_of()."""
        import torch

        arrays, about = self.stored()
        tensors = {f"{entry}.{k}": torch.from_numpy(data.copy()) for k, data in arrays.items()}
        return tensors, {entry: about}

    @staticmethod
    def read(about: Mapping[str, Any], tensor: Callable[[str], NDArray[np.uint8]]) -> Example:
        """The example of what stored() returned.

        Args:
            about: the description.
            tensor: returns the bytes of a name.

        Raises:
            ValueError, KeyError, TypeError: an entry is missing or malformed.
        """
        exemplar = Exemplar.read(about["exemplar"], lambda name: tensor(f"exemplar.{name}"))
        bits = detail_bits(exemplar)
        width, height = exemplar.size
        index = Index.read(
            about["index"], lambda name: tensor(f"index.{name}"), (width >> bits, height >> bits)
        )
        return Example(exemplar, index, bounded(about.get("variety", 1.0), "variety", 0.0, 1.0))

    def varied(self, variety: float | None) -> Example:
        """A copy of another variety; itself for None.

        Raises:
            UsageError: a variety outside [0, 1].
        """
        if variety is None or variety == self.variety:
            return self
        check_variety(variety)
        return Example(self.exemplar, self.index, variety)

    def maps(self, seed: int, area: Rectangle, period: Period | None) -> Floats:
        """(6 or 8, height, width) stacked maps of an area of the field.

        Args:
            seed: in [-2^63, 2^63).
            area: in texels.
            period: of the field, multiples of `alignment`, or None.
        """
        lookup, shown = self._ready.lookup, self._ready.shown
        own, levels = area.coarser(shown.bits), len(lookup.levels)
        votes = [
            Votes.of(band, area, period, shown.bits, levels) for band in range(len(shown.bands))
        ]
        read = {0: own}
        for one in votes:
            read[one.level] = read.get(one.level, one.wanted).united(one.wanted)
        places = coordinates(lookup, seed, read, _coarser(period, shown.bits))

        def of(wanted: Rectangle, level: int) -> Places:
            return places[level][wanted.within(read[level])]

        predicted = [(one, one.predicted(of(one.wanted, one.level), area)) for one in votes]
        return blended(shown, area, of(own, 0), predicted)

    def places(self, seed: int, area: Rectangle, period: Period | None) -> Places:
        """(height, width, 2) int16: x, y of the exemplar at every texel of an area."""
        bits = detail_bits(self.exemplar)
        coarse = area.coarser(bits)
        placed = coordinates(self._ready.lookup, seed, {0: coarse}, _coarser(period, bits))[0]
        if not bits:
            return placed
        side = 1 << bits
        placed = (placed.repeat(side, axis=0).repeat(side, axis=1)) << np.int16(bits)
        within = np.arange(side, dtype=np.int16)
        placed[..., 0] += np.tile(within, coarse.width)
        placed[..., 1] += np.tile(within, coarse.height)[:, None]
        left, top = area.x - (coarse.x << bits), area.y - (coarse.y << bits)
        return placed[top : top + area.height, left : left + area.width]

    @property
    def lookup(self) -> Lookup:
        """Index and phases for the synthesis of places."""
        return self._ready.lookup

    @property
    def _ready(self) -> _Ready:
        with _PREPARING:  # concurrent threads wait for the first one's result
            return self._prepared

    @cached_property
    def _prepared(self) -> _Ready:
        exemplar, bits = self.exemplar, detail_bits(self.exemplar)
        coarse = coarsened(exemplar, bits)
        with ThreadPoolExecutor() as pool:
            bands = pool.submit(bands_of, coarse)
            lookup = prepare(coarse, self.index, self.variety)
            maps = (exemplar.diffuse, exemplar.specular, exemplar.roughness, exemplar.height)
            planes = tuple(plane for planes in maps for plane in planes)
            correlations = _seam_correlations(lookup, bands.result())
            shown = ExemplarBands(planes, bands.result(), correlations, bits)
            return _Ready(lookup, shown)

    def __getstate__(self) -> dict[str, Any]:
        """The fields alone, without cached properties."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


@dataclass(frozen=True)
class ExampleSource:
    """The by-example field of one exemplar and seed; picklable."""

    example: Example
    """The indexed exemplar."""
    seed: int
    """Seed of the realisation."""
    period: Period | None
    """Period in texels, multiples of the example's alignment; None if the field never repeats."""
    texel_size: float
    """A texel's side, plane units."""
    grid: Grid = BLOCKS
    """Grid of blocks."""

    @property
    def specular_channels(self) -> int:
        """Channels of F0: 1, or 3 where it has a colour."""
        return len(self.example.exemplar.specular)

    @property
    def device_type(self) -> str:
        """Device that computes it."""
        return "cpu"

    def maps(self, block: Rectangle) -> Tensor:
        """Stacked maps (6 or 8, height + 2 RING, width + 2 RING) of a block and its ring."""
        import torch

        return torch.from_numpy(self._stacked(block))

    def planes(self, block: Rectangle, normal: NormalStyle) -> NDArray[np.float32]:
        """(9 or 11, height, width) maps and normal of a block."""
        return with_normals(self._stacked(block), self.texel_size, normal)

    def _stacked(self, block: Rectangle) -> NDArray[np.float32]:
        return self.example.maps(self.seed, block.grown(RING), self.period)


def patch_sizes(example: Example) -> PatchSizes:
    """Sizes of the patches of an example's coarsest level, in texels of its grid of places."""
    bits, depth = detail_bits(example.exemplar), len(example.index.bases) - 1
    width, height = (side >> bits for side in example.exemplar.size)
    frame = frame_of(depth, width, height)
    lattice = kept_lattice(example.index, example.variety)
    return PatchSizes.of(frame, 1 << depth, lattice, example.variety)


def detail_bits(exemplar: Exemplar) -> int:
    """How many times an exemplar is halved to its grid of places."""
    bits = 0
    while max(exemplar.size) >> bits > _GRID:
        bits += 1
    return bits


def _seam_correlations(lookup: Lookup, bands: tuple[Band, ...]) -> tuple[float, ...]:
    """seam_correlations of a sample of the field."""
    level, side = _MEASURED
    level = min(level, len(lookup.levels) - 1)
    places = coordinates(lookup, 0, {level: Rectangle(0, 0, side, side)}, None)[level]
    return seam_correlations(bands, places, 1 << level)


def _coarser(period: Period | None, bits: int) -> Period | None:
    """A period in steps of 2^bits texels."""
    return (
        None
        if period is None
        else (period[0] and period[0] >> bits, period[1] and period[1] >> bits)
    )


def known_part(exemplar: Exemplar, multiple: int) -> Rectangle:
    """Bounding rectangle of the texels with any confidence; x and y are rounded up to multiples."""
    known = exemplar.confidence.max(axis=0) > 0.0
    if not known.any():
        return Rectangle(0, 0, *exemplar.size)
    rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
    x, y = (-(-int(side[0]) // multiple) * multiple for side in (columns, rows))
    return Rectangle(x, y, int(columns[-1]) + 1 - x, int(rows[-1]) + 1 - y)


def coarsened(exemplar: Exemplar, bits: int) -> Exemplar:
    """An exemplar at 2^-bits of the resolution, by averages of 2 x 2 texels."""
    for _ in range(bits):
        exemplar = replace(
            exemplar,
            **{
                name: _halved(getattr(exemplar, name))
                for name in ("diffuse", "specular", "roughness", "height", "confidence")
            },
            texel_size=2.0 * exemplar.texel_size,
        )
    return exemplar


def _halved(planes: Floats) -> Floats:
    rows, columns = planes.shape[1] // 2 * 2, planes.shape[2] // 2 * 2
    pairs = planes[:, 0:rows:2, :columns] + planes[:, 1:rows:2, :columns]
    return (pairs[:, :, 0::2] + pairs[:, :, 1::2]) * np.float32(0.25)
