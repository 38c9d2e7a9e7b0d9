"""The inner loops of relighting compiled, where they were built: as their plain forms, faster.

Plain forms: shadows.lit, _Block.area_shadow and the nodes of _Block.integrate (shade.py), _look and
_gather (texel_horizons.py), hidden (effects/environment.py). All effects everywhere run those, so
that the pictures that these help to make are held to them.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any

import numpy as np

from matcap.relight.effects.area import AreaLight, Rule
from matcap.relight.horizons import AZIMUTHS, direction
from matcap.relight.relief import Relief
from matcap.relight.scene import SphereLight
from matcap.relight.surfaces.hits import Hits
from matcap.relight.tables import albedo
from matcap.relight.vectors import Array, Vec, unit3
from matcap.relight.visible_normals import Lobe, lattice

_FORM, _LANES, CHANNELS = 1, 8, 9  # of kernel.c, as is AZIMUTHS
_LIFT = 2e-6  # of shadows.py
# (AZIMUTHS, 2) rightwards and upwards.
_WAYS = np.array([direction(azimuth) for azimuth in range(AZIMUTHS)])

_Pointer, _Int, _Float = ctypes.c_void_p, ctypes.c_int32, ctypes.c_float
_Three = _Pointer * 3


class _Field(ctypes.Structure):
    _fields_ = (
        ("heights", _Pointer), ("columns", _Int), ("rows", _Int), ("lift", _Float),
        ("high", ctypes.c_double), ("texel", ctypes.c_double),
    )  # fmt: skip


class _Pixels(ctypes.Structure):
    _fields_ = (
        ("point", _Three), ("frame", _Pointer * 9), ("normal", _Three), ("view", _Three),
        ("n_dot_v", _Pointer), ("alpha", _Pointer), ("near", _Pointer),
    )  # fmt: skip


class _Light(ctypes.Structure):
    _fields_ = (
        ("a", _Pointer), ("b", _Pointer), ("c", _Pointer), ("weight", _Pointer),
        ("cell", _Pointer), ("nodes", _Int), ("cells", _Int),
        ("normal", _Float * 3), ("area", _Float), ("place", _Float * 3), ("radius", _Float),
    )  # fmt: skip


class _Walk(ctypes.Structure):
    _fields_ = (
        *((name, _Pointer) for name in (
            "padded", "lit", "cosine", "sine", "offset", "middle", "inverse", "end", "nearest",
        )),
        ("steps", _Int), ("parts", _Int), ("highest", _Float),
    )  # fmt: skip


class _Lobes(ctypes.Structure):
    _fields_ = (
        *((name, _Three) for name in (
            "normal", "view", "across", "along", "middle", "stretched",
        )),
        ("n_dot_v", _Pointer), ("alpha", _Pointer),
    )  # fmt: skip


class _Lattice(ctypes.Structure):
    _fields_ = (
        *((name, _Pointer) for name in ("u", "cosine", "sine", "weight")), ("points", _Int),
    )  # fmt: skip


@cache
def kernel() -> Any | None:  # noqa: ANN401
    """The library, or None where it was not built, or from another form of its file."""
    for suffix in EXTENSION_SUFFIXES:
        path = Path(__file__).with_name(f"kernel{suffix}")
        if path.is_file():
            try:
                library = ctypes.CDLL(str(path))
                if library.matcap_relight_form() == _FORM:
                    return library
            except (OSError, AttributeError):
                continue
    return None


class _Kept:
    """Arrays as the kernel reads them, alive for as long as it does."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._arrays: list[Array] = []

    def each(self, values: Array, dtype: type = np.float32) -> int:
        """Address of values of all pixels, one for each."""
        return self.of(np.broadcast_to(np.ravel(values), self.count), dtype)

    def of(self, values: Array | Sequence[float], dtype: type = np.float32) -> int:
        """Address of any values."""
        array: Array = np.ascontiguousarray(values, dtype=dtype)
        self._arrays.append(array)
        return array.ctypes.data

    def vector(self, vector: Vec) -> Any:  # noqa: ANN401
        """Addresses of a vector of each pixel."""
        return _Three(*(self.each(one) for one in vector))


@dataclass(frozen=True)
class LitPixels:
    """Pixels as their lights see them, (1, N) or one for all.

    Attributes:
        hits: where they are.
        height: of the surface there.
        shelter: tangents of elevations from which on nothing hides a light.
        normal: shading normals.
        n_dot_v: cosines of the view.
        alpha: GGX's.
        near: Albedo.near() of it; None without multiple scattering.
    """

    hits: Hits
    height: Array
    shelter: Array
    normal: Vec
    n_dot_v: Array
    alpha: Array
    near: Array | None


@dataclass(frozen=True)
class RuleSums:
    """What a rule adds up to for light of radiance 1, (1, N) each.

    Attributes:
        irradiance: on the shading normal.
        mirrored: the GGX lobe times it.
        fresnel: that times Schlick's weight.
        lost: the energy that single scattering loses, times it.
        flow: irradiance times direction.
    """

    irradiance: Array
    mirrored: Array
    fresnel: Array
    lost: Array
    flow: Vec


def lit(
    relief: Relief,
    place: tuple[Array, Array],
    height: Array,
    to_light: Vec,
    distance: Array | None,
) -> Array:
    """As shadows.lit."""
    shape = np.broadcast_shapes(*(a.shape for a in (*place, height, *to_light)))
    column, row = relief.texels(*place)
    kept = _Kept(int(np.prod(shape)))

    def each(values: Array, dtype: type = np.float32) -> int:
        return kept.each(np.broadcast_to(values, shape), dtype)

    found = np.empty(kept.count, dtype=np.uint8)
    _library().matcap_relight_lit(
        ctypes.byref(_field(relief, kept)), ctypes.c_int64(kept.count),
        *map(_Pointer, (
            each(column, np.float64), each(row, np.float64), each(height),
            *(each(one) for one in to_light), None if distance is None else each(distance),
            found.ctypes.data,
        )),
    )  # fmt: skip
    return found.reshape(shape).astype(bool)


def met(
    relief: Relief,
    reach: int,
    place: tuple[Array, Array],
    move: tuple[Array, Array],
    steps: Array,
    near: Array,
) -> Array:
    """Heights at which rays meet the surface, as parallax._met.

    Args:
        relief: the surface.
        reach: texels around a place of which the highest is known.
        place: (N,) where rays meet the undisplaced surface.
        move: how far they move on it per unit of height.
        steps: that each takes at most.
        near: steps that stay within reach.
    """
    kept = _Kept(len(place[0]))
    column, row = relief.texels(*place)
    across, down = move[0] / relief.texel_size, -move[1] / relief.texel_size
    found = np.empty(kept.count, dtype=np.float32)
    _library().matcap_relight_met(
        ctypes.byref(_field(relief, kept)), _Pointer(kept.of(relief.peaks(reach))),
        ctypes.c_double(relief.low), ctypes.c_int64(kept.count),
        *(_Pointer(kept.each(one, np.float64)) for one in (column, row, across, down, steps, near)),
        _Pointer(found.ctypes.data),
    )  # fmt: skip
    return found


def parts_lit(relief: Relief, light: AreaLight, rule: Rule, pixels: LitPixels, count: int) -> Array:
    """(cells, N) share that arrives of each part of a light, as _Block.area_shadow.

    Args:
        relief: what casts the shadows.
        light: the light.
        rule: the points of it that rays go to.
        pixels: N of them.
        count: N.
    """
    kept = _Kept(count)
    column, row = relief.texels(*pixels.hits.place)
    found = np.empty((rule.cells, count), dtype=np.float32)
    _library().matcap_relight_parts(
        ctypes.byref(_field(relief, kept)), ctypes.byref(_light(light, rule, kept)),
        ctypes.byref(_pixels(pixels, kept)), ctypes.c_int64(count),
        *map(_Pointer, (
            kept.each(column, np.float64), kept.each(row, np.float64), kept.each(pixels.height),
            kept.each(pixels.shelter), found.ctypes.data,
        )),
    )  # fmt: skip
    return found


def rule_sums(
    light: AreaLight, rule: Rule, pixels: LitPixels, count: int, shadow: Array | None, *, lobe: bool
) -> RuleSums:
    """What a rule's points add up to.

    Args:
        light: the light.
        rule: its points.
        pixels: N of them.
        count: N.
        shadow: (cells, N) share that arrives of each part.
        lobe: whether the specular lobe is wanted.
    """
    kept, sums = _Kept(count), np.zeros((7, count), dtype=np.float32)
    lost = albedo().lost if pixels.near is not None else np.zeros(1, dtype=np.float32)
    _library().matcap_relight_rule(
        ctypes.byref(_light(light, rule, kept)), ctypes.byref(_pixels(pixels, kept)),
        ctypes.c_int64(count),
        _Pointer(None if shadow is None else kept.of(shadow)),
        _Pointer(None if pixels.near is None else kept.of(lost)), _Int(lost.size),
        _Float(albedo().lost_step), _Int(lobe), _Pointer(sums.ctypes.data),
    )  # fmt: skip
    one, two, three, four, x, y, z = (row[None] for row in sums)
    return RuleSums(one, two, three, four, (x, y, z))


@dataclass(frozen=True, eq=False)
class HorizonSteps:
    """How horizons are walked to.

    Attributes:
        parts: distances in texels, in parts.
        padded: (rows, columns) heights in texels, the repetition around.
        lit: (rows, columns, CHANNELS) what each of those texels reflects; None where it is not
            asked for.
        highest: of the heights.
    """

    parts: Sequence[Sequence[int]]
    padded: Array
    lit: Array | None
    highest: float

    @cached_property
    def offset(self) -> Array:
        """(AZIMUTHS, steps) how far away in the padded field each step is."""
        moves = self._moves
        offset: Array = moves[1] * self.padded.shape[1] + moves[0]
        return offset.astype(np.int32)

    @cached_property
    def inverse(self) -> Array:
        """(AZIMUTHS, steps) of the distance, texels."""
        return (1.0 / np.hypot(*self._moves)).astype(np.float32)

    @cached_property
    def nearest(self) -> Array:
        """(parts,) of the least distance in each part."""
        ends = np.cumsum([len(part) for part in self.parts])[:-1]
        return np.array([one.max() for one in np.split(self.inverse, ends, axis=1)])

    @cached_property
    def middle(self) -> Array:
        """(AZIMUTHS, parts) where the light of each part is taken from, as `offset`."""
        reach = np.sqrt([part[0] * part[-1] for part in self.parts])
        across, down = _moves(reach)
        return (down * self.padded.shape[1] + across).astype(np.int32)

    @cached_property
    def _moves(self) -> tuple[Array, Array]:
        return _moves(np.array([step for part in self.parts for step in part]))


def look(
    steps: HorizonSteps, spot: Array, own: Array, sx: Array, sy: Array, nz: Array
) -> tuple[Array, Array]:
    """(N, AZIMUTHS) horizons of texels, and (N, 2) what they leave open; see TexelHorizons.

    Args:
        steps: where to look.
        spot: where the texels are in the padded field.
        own, sx, sy, nz: heights, slopes and normals of each.
    """
    kept = _Kept(len(spot))
    tangents = np.empty((len(spot), AZIMUTHS), dtype=np.float32)
    found = np.empty((len(spot), 2), dtype=np.float32)
    _library().matcap_relight_look(
        ctypes.byref(_walk(steps, kept)), ctypes.c_int64(len(spot)),
        *map(_Pointer, (
            kept.each(spot, np.int64), *(kept.each(one) for one in (own, sx, sy, nz)),
            tangents.ctypes.data, found.ctypes.data,
        )),
    )  # fmt: skip
    return tangents, found


def gather(steps: HorizonSteps, spot: Array, own: Array, sx: Array, sy: Array, nz: Array) -> Array:
    """(N, CHANNELS) transfer vectors of texels; arguments as of look()."""
    kept = _Kept(len(spot))
    found = np.empty((len(spot), CHANNELS), dtype=np.float32)
    _library().matcap_relight_gather(
        ctypes.byref(_walk(steps, kept)), ctypes.c_int64(len(spot)),
        *map(_Pointer, (
            kept.each(spot, np.int64), *(kept.each(one) for one in (own, sx, sy, nz)),
            found.ctypes.data,
        )),
    )  # fmt: skip
    return found


def hidden(
    lobe: Lobe, samples: int, tangents: Array | None, texel: Array | None, highest: Array
) -> tuple[Array, Array]:
    """As environment.hidden with `highest`.

    Args:
        lobe: of the pixels.
        samples: how many directions.
        tangents: (H W, AZIMUTHS) horizons of the material, and
        texel: of each pixel; None where no relief hides anything.
        highest: sines of the highest elevations that horizons reach.
    """
    shape = lobe.middle[2].shape
    kept = _Kept(int(np.prod(shape)))
    points = _padded_lattice(samples)
    told = _Lattice(*(kept.of(row) for row in points), points.shape[1])
    lobes = _Lobes(
        *(kept.vector(one) for one in (
            lobe.normal, lobe.to_view, lobe.across, lobe.along, lobe.middle, lobe.stretched,
        )),
        kept.each(lobe.n_dot_v), kept.each(lobe.alpha),
    )  # fmt: skip
    scale, bias = np.empty((2, *shape), dtype=np.float32)
    _library().matcap_relight_hidden(
        ctypes.byref(lobes), ctypes.byref(told), ctypes.c_int64(kept.count),
        _Pointer(None if tangents is None else kept.of(tangents)),
        _Pointer(None if texel is None else kept.each(texel, np.int64)),
        *map(_Pointer, (kept.each(highest), scale.ctypes.data, bias.ctypes.data)),
    )  # fmt: skip
    return scale, bias


def _library() -> Any:  # noqa: ANN401
    library = kernel()
    assert library is not None
    return library


def _field(relief: Relief, kept: _Kept) -> _Field:
    width, height = relief.texture.size
    lift = _LIFT * (relief.high - relief.low)
    return _Field(kept.of(relief.heights), width, height, lift, relief.high, relief.texel_size)


def _light(light: AreaLight, rule: Rule, kept: _Kept) -> _Light:
    more = -len(rule.weights) % _LANES
    a, b, c = (np.pad(one, (0, more), mode="edge") for one in rule.places)
    weights, cells = np.pad(rule.weights, (0, more)), np.pad(rule.cell, (0, more))
    normal, place, area, radius = (0.0, 0.0, 0.0), light.position, 1.0, 0.0
    if isinstance(light, SphereLight):
        radius = light.radius
    else:
        x, y, z = unit3(light.normal)
        normal, area = (x, y, z), light.size[0] * light.size[1]
    return _Light(
        kept.of(a), kept.of(b), kept.of(c), kept.of(weights), kept.of(cells, np.int32),
        len(weights), rule.cells, (_Float * 3)(*normal), area, (_Float * 3)(*place), radius,
    )  # fmt: skip


def _pixels(pixels: LitPixels, kept: _Kept) -> _Pixels:
    frame: Mapping[int, int] = {}
    if pixels.hits.frame is not None:
        axes = (one for axis in pixels.hits.frame for one in axis)
        frame = {k: kept.each(one) for k, one in enumerate(axes)}
    return _Pixels(
        kept.vector(pixels.hits.point), (_Pointer * 9)(*(frame.get(k) for k in range(9))),
        kept.vector(pixels.normal), kept.vector(pixels.hits.to_view),
        kept.each(pixels.n_dot_v), kept.each(pixels.alpha),
        None if pixels.near is None else kept.each(pixels.near),
    )  # fmt: skip


def _walk(steps: HorizonSteps, kept: _Kept) -> _Walk:
    c, s = _WAYS.T
    return _Walk(
        kept.of(steps.padded), None if steps.lit is None else kept.of(steps.lit),
        kept.of(c), kept.of(s),
        kept.of(steps.offset, np.int32), kept.of(steps.middle, np.int32), kept.of(steps.inverse),
        kept.of(np.cumsum([len(part) for part in steps.parts]), np.int32),
        kept.of(steps.nearest),
        steps.offset.shape[1], len(steps.parts), steps.highest,
    )  # fmt: skip


def _moves(reach: Array) -> tuple[Array, Array]:
    """Columns to the right and rows down, of distances along each azimuth."""
    c, s = _WAYS.T[..., None]
    return np.rint(c * reach).astype(np.int64), -np.rint(s * reach).astype(np.int64)


@cache
def _padded_lattice(samples: int) -> Array:
    """(4, points) heights, cosines, sines and weights, up to a multiple of what is read at once."""
    rows = np.array(lattice(samples), dtype=np.float32).T
    return np.pad(rows, ((0, 0), (0, -rows.shape[1] % _LANES)))
