"""The by-example generator: an exemplar with its index, read from `.matcap` files; its summary."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from matcap.example.blend import (
    ArraySource,
    Band,
    ExemplarBands,
    Votes,
    bands_of,
    blended,
    seam_correlations,
)
from matcap.example.candidates import Frame, PatchSizes, frame_of, level_count
from matcap.example.coordinates import Places, coordinates, initial_places
from matcap.example.exemplar import Exemplar, Floats
from matcap.example.index import Index, Lookup, build_index, kept_lattice, prepare
from matcap.example.lattice import GRID, Frequency
from matcap.example.repeat import BLOCKS, RepeatedSource
from matcap.field.header import opened
from matcap.field.plane import Grid, Period, Rectangle, check_period, check_seed, check_variety
from matcap.files.settings import bounded
from matcap.files.threads import at_once

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from matcap.brdf.maps import MapSet

# Places are synthesised on a grid of at most _GRID texels. A larger exemplar is halved to that grid
# for the synthesis, and its maps are read at full resolution.

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
        exemplar: Exemplar,
        waves: tuple[Frequency, ...] = (),
        *,
        straight: bool = False,
        part: Frame | None = None,
        one_light: bool = True,
    ) -> Example:
        """Index an exemplar that is rounded as in a file; arguments and errors of `of`.

        With `straight`, waves are exact and the lattice has no bend; fields show only a `part`.
        `one_light`: see build_index.
        """
        bits = detail_bits(exemplar)
        coarse = coarsened(exemplar, bits)
        part = part and part.halved(bits)
        if not level_count(*(part or Frame.of(*coarse.size)).size):
            raise ValueError(f"an exemplar of {exemplar.size} texels")
        scaled = tuple((fx * 2**bits, fy * 2**bits) for fx, fy in waves)
        index = build_index(coarse, scaled, straight=straight, part=part, one_light=one_light)
        return Example(exemplar, index)

    @property
    def alignment(self) -> int:
        """Texels: periods of its field are multiples of this."""
        return 1 << (detail_bits(self.exemplar) + len(self.index.bases) - 1)

    @property
    def texel_size(self) -> float:
        """Side of a texel, plane units."""
        return self.exemplar.texel_size

    @property
    def piece_size(self) -> tuple[int, int]:
        """(width, height) of the exemplar in texels."""
        return self.exemplar.size

    def piece(self) -> MapSet:
        """Maps of the exemplar."""
        import torch

        from matcap.brdf.maps import MapSet

        stacked = torch.from_numpy(self.exemplar.stacked())
        return MapSet.from_stacked(stacked, self.exemplar.texel_size)

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
        from matcap.example.repeat import repeated

        exemplar, lattice, part = self.exemplar, self.index.lattice, self.index.part
        bits = detail_bits(exemplar)
        box = known_part(exemplar, 1 << (GRID + bits), part and part.enlarged(bits))
        rows, columns = slice(box.y, box.y + box.height), slice(box.x, box.x + box.width)
        within = lattice and lattice.cropped(box.x >> bits, box.y >> bits)
        maps = exemplar.stacked()[:, rows, columns]
        tile = repeated(maps, exemplar.texel_size, within, bits)
        return RepeatedSource(tile.maps, exemplar.texel_size)

    def stored(self) -> tuple[dict[str, NDArray[np.uint8]], dict[str, Any]]:
        """Tensors, and a description for JSON; the inverse of read()."""
        maps, about = self.exemplar.stored()
        chosen, about_index = self.index.stored()
        tensors = {f"exemplar.{name}": data for name, data in maps.items()}
        tensors |= {f"index.{name}": data for name, data in chosen.items()}
        described: dict[str, Any] = {"exemplar": about, "index": about_index}
        # A file without a variety has variety 1.
        return tensors, described | ({} if self.variety == 1.0 else {"variety": self.variety})

    def in_file(
        self, by_example: object = None, entry: str = "example"
    ) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Tensors and an entry of a material's description; the inverse of example_of()."""
        import torch

        arrays, about = self.stored()
        tensors = {f"{entry}.{k}": torch.from_numpy(data.copy()) for k, data in arrays.items()}
        return tensors, {entry: about}

    @staticmethod
    def read(about: Mapping[str, Any], tensor: Callable[[str], NDArray[np.uint8]]) -> Example:
        """The example of what stored() returned.

        Args:
            tensor: returns the bytes of a name.

        Raises:
            ValueError, KeyError, TypeError: an entry is missing or malformed.
        """
        exemplar = Exemplar.read(about["exemplar"], lambda name: tensor(f"exemplar.{name}"))
        bits = detail_bits(exemplar)
        width, height = exemplar.size
        size = width >> bits, height >> bits
        index = Index.read(about["index"], lambda name: tensor(f"index.{name}"), size)
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
        votes = [Votes.of(k, area, period, shown.bits, levels) for k in range(len(shown.bands))]
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
        bands, lookup = at_once(
            partial(bands_of, coarse), partial(prepare, coarse, self.index, self.variety)
        )
        maps = (exemplar.diffuse, exemplar.specular, exemplar.roughness, exemplar.height)
        planes = tuple(plane for planes in maps for plane in planes)
        shown = ExemplarBands(planes, bands, _seam_correlations(lookup, bands), bits)
        return _Ready(lookup, shown)

    def __getstate__(self) -> dict[str, Any]:
        """The fields alone, without cached properties."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


@dataclass(frozen=True)
class ExampleSource(ArraySource):
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

    def around(self, area: Rectangle) -> NDArray[np.float32]:
        """Stacked maps (6 or 8, height, width) of any area."""
        return self.example.maps(self.seed, area, self.period)


def patch_sizes(example: Example) -> PatchSizes:
    """Sizes of the patches of an example's coarsest level, in texels of its grid of places."""
    bits, depth = detail_bits(example.exemplar), len(example.index.bases) - 1
    width, height = (side >> bits for side in example.exemplar.size)
    frame = frame_of(depth, example.index.part or Frame.of(width, height))
    lattice = kept_lattice(example.index, example.variety)
    return PatchSizes.of(frame, 1 << depth, lattice, example.variety, example.index.aspect)


def detail_bits(exemplar: Exemplar) -> int:
    """How many times an exemplar is halved to its grid of places."""
    return halvings(max(exemplar.size))


def halvings(longer: int) -> int:
    """How many times an exemplar with this longer side is halved to its grid of places."""
    bits = 0
    while longer >> bits > _GRID:
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
    if period is None:
        return None
    return period[0] and period[0] >> bits, period[1] and period[1] >> bits


def known_part(exemplar: Exemplar, multiple: int, part: Frame | None = None) -> Rectangle:
    """Bounding rectangle of the texels with any confidence in a part; None for all.

    x and y are rounded up to multiples.
    """
    known = exemplar.confidence.max(axis=0) > 0.0
    if part is not None:
        within = np.zeros_like(known)
        within[part.top : part.bottom + 1, part.left : part.right + 1] = True
        known &= within
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
                name: halved(getattr(exemplar, name))
                for name in ("diffuse", "specular", "roughness", "height", "confidence")
            },
            texel_size=2.0 * exemplar.texel_size,
        )
    return exemplar


def halved(planes: Floats) -> Floats:
    """(C, H // 2, W // 2) averages of 2 x 2 texels of planes (C, H, W)."""
    rows, columns = planes.shape[1] // 2 * 2, planes.shape[2] // 2 * 2
    pairs = planes[:, 0:rows:2, :columns] + planes[:, 1:rows:2, :columns]
    return (pairs[:, :, 0::2] + pairs[:, :, 1::2]) * np.float32(0.25)


# Coarse levels of detail: for each square of 2^level texels, a place of the exemplar.
#
# Synthesis runs from coarse to fine, so that a coarse level is a prefix of it. Beyond the coarsest
# level each square has its initial patch, independent of its neighbours. The result is close to,
# but not exactly, the mean of the finest level, whose corrections move seams.


def coarse_places(example: Example, seed: int, level: int, area: Rectangle) -> Places:
    """(height, width, 2) int16: x, y of the exemplar at each square's upper left texel.

    Args:
        seed: in [-2^63, 2^63).
        level: squares are 2^level texels wide; at least detail_bits of the exemplar.
        area: in squares.
    """
    bits, lookup = detail_bits(example.exemplar), example.lookup
    coarsest = len(lookup.levels) - 1
    depth = max(level - bits, 0)
    if level < bits:
        raise ValueError(f"level {level} is finer than the grid of places ({bits})")
    if depth <= coarsest:
        places = coordinates(lookup, seed, {depth: area}, None)[depth]
    else:
        step = depth - coarsest
        columns = np.arange(area.x, area.x + area.width) << step
        rows = np.arange(area.y, area.y + area.height) << step
        places = initial_places(lookup, seed, columns, rows, None)
    return places << np.int16(bits)


# Reads the exemplar of a `.matcap` file, without PyTorch.


@dataclass(frozen=True)
class Exemplified:
    """A material's exemplar with its name, provenance and default generator."""

    name: str
    """Name of the material."""
    provenance: dict[str, Any]
    """Record of how it was made; JSON."""
    example: Example
    """The indexed exemplar."""
    default: str = "example"
    """Generator that makes the material's maps."""


def read_exemplified(path: Path, entry: str = "example") -> Exemplified | None:
    """Read the exemplar of a `.matcap` file, or None if it has none.

    Args:
        entry: "example", or "drawing" for the exemplar that a decoder draws from.

    Raises:
        MatcapError: missing, not a material, of another version, or damaged.
    """
    with opened(path, "np") as (file, about):
        if not isinstance(about.get(entry), dict) or "exemplar" not in about[entry]:
            return None
        example = example_of(about, file, entry)
        default = about.get("generator", "example")
        return Exemplified(about["name"], about["provenance"], example, default)


def read(about: Mapping[str, Any], file: Any, path: Path, by_example: object) -> Example | None:  # noqa: ANN401
    """Read the exemplar of an opened material's file, or None; `by_example` is unused.

    Args:
        file: opened for NumPy or for PyTorch.

    Raises:
        SafetensorError, DAMAGED (field/header.py): the data are missing or malformed.
    """
    return example_of(about, file) if "example" in about else None


def example_of(about: Mapping[str, Any], file: Any, entry: str = "example") -> Example:  # noqa: ANN401
    """The example of an entry of the description. Raises as read(), and KeyError without it."""

    def data(name: str) -> NDArray[np.uint8]:
        array = np.asarray(file.get_tensor(f"{entry}.{name}"))
        if array.dtype != np.uint8 or array.ndim != 1:
            raise ValueError(f"{name} is no bytes")
        return array

    return Example.read(about[entry], data)


# Summary of an exemplar: size, periods of its lattice, unused share, variety, F0.


@dataclass(frozen=True)
class Summary:
    """Summary of one exemplar."""

    size: tuple[int, int]
    """(width, height) in texels."""
    periods: tuple[float, ...]
    """Periods of its lattice in texels; empty without one."""
    left_out: float
    """Share that stands out, such as stains, which fields avoid."""
    variety: float
    """Variety in [0, 1]; see ReadOptions."""
    patches: tuple[int, int]
    """Largest (width, height) of the field's patches, texels."""
    texel_size: float
    """Side of a texel in plane units."""
    f0: tuple[float, ...] = ()
    """Mean specular albedo: one number, or three where it has a colour."""

    def document(self) -> dict[str, Any]:
        """The summary for JSON."""
        periods = [round(period, 2) for period in self.periods]
        return {
            "size": list(self.size), "periods": periods, "left_out": self.left_out,
            "variety": self.variety, "patches": list(self.patches),
            "f0": [round(value, 4) for value in self.f0],
        }  # fmt: skip

    def patches_text(self, millimetres: float | None = None) -> str:
        """Size of the patches as a phrase; `millimetres` is of a plane unit, if known."""
        longer = max(self.patches)
        if millimetres is not None:
            return f"patches of about {longer * self.texel_size * millimetres / 10.0:.2g} cm"
        return f"patches of about {100 * longer / max(self.size):.0f} % of the photograph's width"

    def lines(self, millimetres: float | None = None) -> list[tuple[str, str]]:
        """(name, sentence) of each entry; `millimetres` is of a plane unit, if known."""
        width, height = self.size
        lattice = "Not periodic."
        if self.periods:
            periods = " and ".join(f"{period:.1f}" for period in self.periods)
            lattice = f"It repeats every {periods} texels."
        return [
            ("exemplar", f"{width} x {height} texels of the photographed rectangle."),
            ("lattice", lattice),
            ("variety", f"{self.variety:g}: {self.patches_text(millimetres)}."),
            (
                "left out",
                f"{100 * self.left_out:.1f} % stands out, such as stains; fields avoid it.",
            ),
            ("specular", self._specular()),
        ]

    def _specular(self) -> str:
        """Mean F0 as a sentence."""
        mean = ", ".join(f"{value:.2g}" for value in self.f0)
        if len(self.f0) == 1:
            return f"Mean F0 {mean}, without a colour."
        return f"Mean F0 {mean} (red, green, blue): some of it is metal."


def summary(example: Example) -> Summary:
    """Summarise an example."""
    lattice = example.index.lattice
    waves = () if lattice is None else lattice.waves
    side = 1 << detail_bits(example.exemplar)
    periods = tuple(side / math.hypot(*wave) for wave in waves)
    sizes = patch_sizes(example)
    laid = kept_lattice(example.index, example.variety)
    wide, high = (sizes.width, sizes.height) if laid is None else (round(sizes.cells),) * 2
    return Summary(
        example.exemplar.size,
        periods,
        example.index.left_out,
        example.variety,
        (wide * side, high * side),
        example.exemplar.texel_size,
        tuple(float(plane.mean(dtype=np.float64)) for plane in example.exemplar.specular),
    )
