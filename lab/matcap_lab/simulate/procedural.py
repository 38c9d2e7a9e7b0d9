"""Random fields that procedural materials are made of, and the MapSet made of them.

Every field is defined on the plane, in plane units, and only sampled on a grid: a finer grid of
the same rectangle and seed shows the same realisation in more detail (noise beyond a grid's
Nyquist frequency is left out, so it does not alias). Float64 numpy throughout.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from matcap.brdf.maps import MapSet

Raster = NDArray[np.float64]

# Beyond this multiple of 1 / fine a spectrum's amplitude is under 1e-3 of its plateau.
_CUTOFF = 1.62
# Texels worked on at a time in the search for cells: small enough to stay in the cache.
_CHUNK = 32_768


@dataclass(frozen=True)
class Canvas:
    """A rectangle of plane, in texels of a size in plane units, and the seed of a realisation."""

    width: int
    height: int
    texel_size: float
    seed: int

    @property
    def extent(self) -> tuple[float, float]:
        """(width, height) in plane units."""
        return self.width * self.texel_size, self.height * self.texel_size

    @property
    def x(self) -> Raster:
        """(1, W) places of the texels' centres, from the left border."""
        return ((np.arange(self.width, dtype=np.float64) + 0.5) * self.texel_size)[None, :]

    @property
    def y(self) -> Raster:
        """(H, 1) places of the texels' centres, from the top border, downwards."""
        return ((np.arange(self.height, dtype=np.float64) + 0.5) * self.texel_size)[:, None]

    def stream(self, label: str) -> np.random.Generator:
        """Generator of the label's own stream of this seed."""
        return np.random.default_rng([self.seed, zlib.crc32(label.encode())])


@dataclass(frozen=True)
class Spectrum:
    """Amplitude spectrum of a noise field; wavelengths in plane units."""

    coarse: float
    """Long-wavelength cutoff."""
    fine: float
    """Short-wavelength cutoff."""
    slope: float = 1.0
    """Amplitude is f^-slope in between; 1 is natural, 0 is white."""
    stretch: float = 1.0
    """How much longer features are along the grain than across it."""
    angle: float = 0.0
    """Direction of the grain, radians anticlockwise from x."""

    def frequency(self, fx: Raster, fy: Raster) -> Raster:
        """Length of (fx, fy), y downwards, after undoing stretch and angle; cycles a plane unit."""
        cosine, sine = math.cos(self.angle), math.sin(self.angle)
        along = (fx * cosine - fy * sine) * self.stretch
        return np.hypot(along, fx * sine + fy * cosine)

    def amplitude(self, fx: Raster, fy: Raster) -> Raster:
        """Amplitude at (fx, fy), in cycles per plane unit; 0 at frequency 0."""
        f = self.frequency(fx, fy)
        safe = np.maximum(f, 1e-9)
        rise = -np.expm1(-((safe * self.coarse) ** 4))
        fall = np.exp(-((safe * self.fine) ** 4))
        return np.where(f > 0, rise * fall * safe**-self.slope, 0.0)

    def limits(self) -> tuple[float, float]:
        """Largest frequencies along x and y, cycles per plane unit."""
        cosine, sine = abs(math.cos(self.angle)), abs(math.sin(self.angle))
        top = _CUTOFF / self.fine
        return (
            top * math.hypot(cosine / self.stretch, sine),
            top * math.hypot(sine / self.stretch, cosine),
        )


def noise(canvas: Canvas, label: str, spectrum: Spectrum) -> Raster:
    """(H, W) Gaussian noise of zero mean and unit variance."""
    return _synthesise(canvas, label, spectrum, unit_slope=False)


def bumps(canvas: Canvas, label: str, spectrum: Spectrum) -> Raster:
    """(H, W) Gaussian heights in plane units whose root mean square slope is 1."""
    return _synthesise(canvas, label, spectrum, unit_slope=True)


def displacement(
    canvas: Canvas, label: str, spectrum: Spectrum, deviation: float
) -> tuple[Raster, Raster]:
    """Independent noise fields along x and y of a standard deviation, plane units."""
    return (
        deviation * noise(canvas, f"{label} x", spectrum),
        deviation * noise(canvas, f"{label} y", spectrum),
    )


def rms_slope(height: NDArray[Any], texel_size: float) -> float:
    """Root mean square slope of heights."""
    down, right = np.gradient(height, texel_size)
    return float(np.sqrt((down**2 + right**2).mean()))


def _synthesise(canvas: Canvas, label: str, spectrum: Spectrum, *, unit_slope: bool) -> Raster:
    width, height = canvas.width, canvas.height
    extent_x, extent_y = canvas.extent
    limit_x, limit_y = spectrum.limits()
    last_x, last_y = max(1, int(limit_x * extent_x)), max(1, int(limit_y * extent_y))
    column = np.arange(last_x + 1)[None, :]
    fx, fy = column / extent_x, np.arange(-last_y, last_y + 1)[:, None] / extent_y
    amplitude = spectrum.amplitude(fx, fy)
    # Columns other than the zeroth count twice: for themselves and their conjugates.
    weight = np.where(column == 0, 1.0, 2.0)
    measure = (2.0 * math.pi) ** 2 * (fx**2 + fy**2) if unit_slope else 1.0
    power = float((weight * measure * amplitude**2).sum())
    # The draw does not depend on the texel size: finer grids show the same realisation.
    real, imaginary = canvas.stream(label).standard_normal((2, *amplitude.shape))
    wave = (real + 1j * imaginary) * (amplitude * math.sqrt(0.5 / power) if power > 0 else 0.0)
    wave[:, 0] *= math.sqrt(2.0)  # only its real part is left by the inverse transform
    seen_x, seen_y = min(last_x, (width - 1) // 2), min(last_y, (height - 1) // 2)
    wave = wave[last_y - seen_y : last_y + seen_y + 1, : seen_x + 1]
    # Texel centres stand half a texel inside the border.
    wave *= np.exp(1j * math.pi * np.arange(seen_x + 1) / width)[None, :]
    wave *= np.exp(1j * math.pi * np.arange(-seen_y, seen_y + 1) / height)[:, None]
    transform = np.zeros((height, width // 2 + 1), dtype=np.complex128)
    transform[: seen_y + 1, : seen_x + 1] = wave[seen_y:]
    if seen_y:
        transform[-seen_y:, : seen_x + 1] = wave[:seen_y]
    return np.fft.irfft2(transform, s=(height, width), norm="forward")


@dataclass(frozen=True)
class VoronoiCells:
    """A jittered grid's Voronoi cells [worley1996]."""

    nearest: Raster
    """(H, W) distance to the nearest point, in cell sizes."""
    second: Raster
    """(H, W) distance to the second nearest point, in cell sizes."""
    index: NDArray[np.int64]
    """(H, W) index of the cell, below `count`."""
    count: int
    """Number of cells."""
    offset: tuple[Raster, Raster]
    """Two (H, W) fields, x and y from the nearest point, in cell sizes, y downwards."""

    @property
    def border(self) -> Raster:
        """(H, W) second - nearest, in cell sizes: 0 on the border of two cells."""
        return self.second - self.nearest

    def draw(self, generator: np.random.Generator) -> Raster:
        """(H, W) a uniform number in [0, 1) for each cell."""
        return generator.random(self.count)[self.index]


def cells(
    canvas: Canvas,
    label: str,
    size: float,
    *,
    jitter: float = 1.0,
    stretch: float = 1.0,
    angle: float = 0.0,
    warp: tuple[Raster, Raster] | None = None,
) -> VoronoiCells:
    """Voronoi cells of about `size` plane units.

    Args:
        canvas: rectangle and seed.
        label: random stream.
        size: spacing of the points, plane units.
        jitter: 0 for a square grid to 1 for points anywhere in their square.
        stretch: how much longer cells are along the grain than across it.
        angle: direction of the grain, radians anticlockwise from x.
        warp: displacements in plane units, x and y, that bend the cells.
    """
    extent_x, extent_y = canvas.extent
    x, y = np.broadcast_arrays(canvas.x, canvas.y)
    if warp is not None:
        x, y = x + warp[0], y + warp[1]
    cosine, sine = math.cos(angle), math.sin(angle)

    def turned(x: Raster, y: Raster) -> tuple[Raster, Raster]:
        return (x * cosine - y * sine) / (size * stretch), (x * sine + y * cosine) / size

    u, v = turned(x, y)
    corners_u, corners_v = turned(
        np.array([0.0, extent_x, 0.0, extent_x]), np.array([0.0, 0.0, extent_y, extent_y])
    )
    margin = 4
    columns = math.ceil(np.ptp(corners_u)) + 2 * margin
    rows = math.ceil(np.ptp(corners_v)) + 2 * margin
    generator = canvas.stream(label)
    points = 0.5 + jitter * (generator.random((2, rows * columns)) - 0.5)
    # The grid stands elsewhere in every realisation.
    shift_u, shift_v = generator.random(2)
    u = np.clip(u - corners_u.min() + shift_u + margin / 2, 1.0, columns - 1.001)
    v = np.clip(v - corners_v.min() + shift_v + margin / 2, 1.0, rows - 1.001)
    chunks = (np.array_split(w.ravel(), math.ceil(w.size / _CHUNK)) for w in (u, v))
    distances = [
        _nearest(a, b, points[0], points[1], columns) for a, b in zip(*chunks, strict=True)
    ]
    shape = (canvas.height, canvas.width)
    nearest, second, index, du, dv = (
        np.concatenate(part).reshape(shape) for part in zip(*distances, strict=True)
    )
    return VoronoiCells(nearest, second, index, rows * columns, (du, dv))


def _nearest(
    u: Raster, v: Raster, points_u: Raster, points_v: Raster, columns: int
) -> tuple[Raster, Raster, NDArray[np.int64], Raster, Raster]:
    column, row = u.astype(np.int64), v.astype(np.int64)
    base = row * columns + column
    inner_u, inner_v = u - column, v - row
    nearest = np.full(u.shape, np.inf)
    second = np.full(u.shape, np.inf)
    index = np.zeros(u.shape, dtype=np.int64)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            here = base + (down * columns + right)
            du = inner_u - (points_u.take(here, mode="clip") + right)
            dv = inner_v - (points_v.take(here, mode="clip") + down)
            squared = du * du + dv * dv
            closer = squared < nearest
            second = np.where(closer, nearest, np.minimum(second, squared))
            nearest = np.where(closer, squared, nearest)
            index = np.where(closer, here, index)
    index = np.clip(index, 0, points_u.size - 1)
    du = u - (points_u[index] + index % columns)
    dv = v - (points_v[index] + index // columns)
    return np.sqrt(nearest), np.sqrt(second), index, du, dv


@dataclass(frozen=True)
class Weave:
    """Threads crossing over and under each other."""

    height: Raster
    """(H, W) in thread spacings."""
    warp_on_top: NDArray[np.bool_]
    """(H, W) bool, the thread along y is on top."""
    column: NDArray[np.int64]
    row: NDArray[np.int64]
    """(H, W) index of the thread along y, and of the one along x."""
    across: Raster
    """(H, W) coordinate across the top thread, -1 to 1."""
    along: Raster
    """(H, W) coordinate along the top thread, in thread spacings."""

    def per_thread(self, generator: np.random.Generator) -> Raster:
        """(H, W) a standard normal number for each thread."""
        columns = generator.standard_normal(int(self.column.max()) + 1)
        rows = generator.standard_normal(int(self.row.max()) + 1)
        return np.where(self.warp_on_top, columns[self.column], rows[self.row])


def weave(u: Raster, v: Raster, *, over: int = 1, fill: float = 0.95, depth: float = 0.35) -> Weave:
    """A weave of round threads.

    Args:
        u: (H, W) coordinate across the threads along y, in thread spacings, not negative.
        v: (H, W) likewise, across the threads along x.
        over: number of threads a thread passes over: 1 plain weave, 2 or 3 twill.
        fill: a thread's width as share of the spacing.
        depth: amplitude of a thread's centre line, in thread spacings.
    """
    column, row = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    across_u = (2.0 * (u - column) - 1.0) / fill
    across_v = (2.0 * (v - row) - 1.0) / fill
    period = 2 * over
    # A thread's middle line rises where it is on top; columns and rows are in opposite phase.
    phase = 2.0 * math.pi / period
    rise_u = depth * np.sin(phase * (v - 0.5 + column) + math.pi / 2.0 - phase * (over - 1) / 2.0)
    rise_v = -depth * np.sin(phase * (u - 0.5 + row) + math.pi / 2.0 - phase * (over - 1) / 2.0)
    round_u = np.where(np.abs(across_u) < 1, np.sqrt(np.maximum(0.0, 1 - across_u**2)), -2.0)
    round_v = np.where(np.abs(across_v) < 1, np.sqrt(np.maximum(0.0, 1 - across_v**2)), -2.0)
    height_u = rise_u + 0.5 * fill * round_u
    height_v = rise_v + 0.5 * fill * round_v
    on_top = height_u >= height_v
    floor = -0.5 * depth
    return Weave(
        height=np.maximum(np.maximum(height_u, height_v), floor),
        warp_on_top=on_top,
        column=column,
        row=row,
        across=np.clip(np.where(on_top, across_u, across_v), -1.0, 1.0),
        along=np.where(on_top, v, u),
    )


def smoothstep(low: float, high: float, value: Raster) -> Raster:
    """0 below low, 1 above high, smooth in between."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def mix(first: Raster, second: Raster, share: Raster) -> Raster:
    """(1 - share) first + share second; colours are (3, 1, 1) or (3, H, W)."""
    return first + (second - first) * share


def colour(red: float, green: float, blue: float) -> Raster:
    """(3, 1, 1) linear Rec.709 colour."""
    return np.array([red, green, blue], dtype=np.float64)[:, None, None]


def pick(palette: Raster, index: Raster) -> Raster:
    """(3, H, W) colours from a (N, 3) palette at (H, W) places in [0, 1)."""
    return np.moveaxis(palette[(index * len(palette)).astype(np.int64)], -1, 0)


# From the fields of a procedural material to a MapSet.

_DARKEST = 0.004  # diffuse albedo of the darkest dielectrics
_SMOOTHEST = 0.05


def assemble(
    canvas: Canvas,
    diffuse: Raster,
    specular: Raster | float,
    roughness: Raster | float,
    height: Raster,
    darkest: float = _DARKEST,
) -> MapSet:
    """MapSet in float64 of fields that broadcast to (3, H, W) and (H, W), clipped to their ranges.

    F0 of shape (3, H, W) has a colour; `darkest` is the least diffuse albedo.
    """
    coloured = np.ndim(specular) == 3
    shape = (canvas.height, canvas.width)

    def stored(field: Raster | float, channels: int, low: float, high: float) -> torch.Tensor:
        full = np.broadcast_to(np.asarray(field, dtype=np.float64), (channels, *shape))
        return torch.from_numpy(np.clip(full, low, high))

    return MapSet(
        diffuse=stored(diffuse, 3, darkest, 0.95),
        specular=stored(specular, 3 if coloured else 1, 0.02, 1.0 if coloured else 0.98),
        roughness=stored(roughness, 1, _SMOOTHEST, 1.0),
        height=stored(height, 1, -np.inf, np.inf),
        texel_size=canvas.texel_size,
    )
