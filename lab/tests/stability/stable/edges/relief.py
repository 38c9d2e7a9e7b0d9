"""Filtered maps, parallax and self-shadows, against means and slow rays in float64."""

import math

import loop_calls
import numpy as np
from numpy.typing import NDArray

from matcap.relight.camera import Vec
from matcap.relight.effects import relief as parallax
from matcap.relight.relief import Relief
from matcap.relight.texture import Sampler, Texture, alpha_of
from stable.edges.swept import Swept, compared, log_uniform

Values = NDArray[np.float64]
_RAYS = 3000  # of a call
_FINE = 32  # steps a texel of the slow rays
_LIFT = 4e-6  # of the relief: what a shadow ray starts above the surface by, and its rounding


def filtering(g: np.random.Generator) -> Swept:
    """Squares of 2^k texels in float64, and one material whatever the footprint."""
    width, height = (int(side) for side in 2 ** g.integers(2, 8, 2))
    steep = float(log_uniform(g, 1e-4, 1e2))
    texture = _textured(g, width, height, slope=steep)
    sampler = Sampler(texture, 1.0)
    side = 1 << int(g.integers(0, int(math.log2(min(width, height))) + 1))
    rows, columns = np.mgrid[0 : height // side, 0 : width // side]
    column, row = (columns + 0.5) * side - 0.5, (rows + 0.5) * side - 0.5
    u = (column - (width - 1) / 2.0) * texture.texel_size
    v = ((height - 1) / 2.0 - row) * texture.texel_size
    sample = sampler.read((u, v), np.full(u.shape, side * texture.texel_size, np.float32))

    def mean(plane: NDArray[np.floating]) -> Values:
        parted = plane.astype(np.float64).reshape(height // side, side, width // side, side)
        return np.asarray(parted.mean((1, 3)))

    slopes = texture.slopes.astype(np.float64)
    x, y = mean(slopes[0]), mean(slopes[1])
    variance = mean(np.square(slopes).sum(0)) - x * x - y * y
    # Differences of squares: the variance of float32 slopes is known to their squares' rounding.
    alpha = np.sqrt(np.minimum(mean(np.square(alpha_of(texture.roughness[0]))) + variance, 1.0))
    z = 1.0 / np.sqrt(1.0 + x * x + y * y)
    pairs = (
        *((sample.diffuse[i], mean(texture.diffuse[i])) for i in range(3)),
        (sample.specular[0], mean(texture.specular[0])),
        (sample.alpha, alpha),
        *zip(sample.normal, (-x * z, -y * z, z), strict=True),
    )
    where = f"{side} texels a side, slopes of {steep:.2g}"
    found = Swept()
    for value, exact in pairs:
        found += compared(value, exact, 1.0, where)
    return found


def footprints(g: np.random.Generator) -> Swept:
    """A material that is the same everywhere stays what it is, whatever a pixel covers."""
    shape = tuple(int(side) for side in g.integers(1, 40, 2))
    texture = _textured(g, *shape, slope=0.0, even=True)
    place = tuple(log_uniform(g, 1e-9, 1e4, (2, 50, 40)) * g.choice([-1.0, 1.0], (2, 50, 40)))
    wide = log_uniform(g, 1e-30, 1e30, (50, 40)).astype(np.float32)
    sample = Sampler(texture, float(log_uniform(g, 1e-3, 1e3))).read((place[0], place[1]), wide)
    found = Swept()
    for value, map_ in zip(
        (*sample.diffuse, *sample.specular, sample.alpha, *sample.normal),
        (*texture.diffuse, *texture.specular, alpha_of(texture.roughness[0]), *texture.normal),
        strict=True,
    ):
        exact = np.full(wide.shape, float(map_[0, 0]))
        found += compared(value, exact, 1.0, f"{shape[0]} x {shape[1]} texels")
    return found


def parallaxes(g: np.random.Generator) -> Swept:
    """What a ray meets lies on the surface: its height beside the surface's there, in reliefs."""
    relief, (u, v), lift = _field(g)
    direction = _directions(g, 0.05)
    (found_u, found_v), height = parallax.shift(relief, (u, v), direction)
    x, y, z = (c.astype(np.float64) for c in direction)
    run, moved = np.hypot(x, y) / z, np.hypot(found_u - u, found_v - v)
    sign = np.where((found_u - u) * x + (found_v - v) * y < 0.0, -1.0, 1.0)
    steep = run > 1e-3
    span = max(relief.high - relief.low, 1e-30)
    on_ray = (sign * moved / np.maximum(run, 1e-3))[steep]
    return compared(height[steep] / span, on_ray / span, 1.0, f"relief {lift:.2g} of a texel")


def crossings(g: np.random.Generator) -> Swept:
    """How much of a ridge a ray may pass through: followed in steps 32 times as fine.

    In texels of its path, as a share of the half that the method states.
    """
    relief, (u, v), lift = _field(g)
    direction = _directions(g, 0.3)
    (found_u, found_v), _ = parallax.shift(relief, (u, v), direction)
    x, y, z = (c.astype(np.float64) for c in direction)
    du, dv = x / z, y / z
    span, run = relief.high - relief.low, np.hypot(du, dv) / relief.texel_size
    steps = max(8, math.ceil(_FINE * float(run.max()) * span))
    # The height at which the ray is where it was found to end.
    ended = ((found_u - u) * du + (found_v - v) * dv) / np.maximum(du * du + dv * dv, 1e-12)
    inside, longest = np.zeros(u.shape), np.zeros(u.shape)
    for level in np.linspace(relief.high, relief.low, steps + 1):
        below = _surface(relief, u + du * level, v + dv * level) > level
        inside = np.where(below & (level > ended), inside + run * span / steps, 0.0)
        longest = np.maximum(longest, inside)
    return compared(2.0 * longest, 0.0 * longest, 1.0, f"relief {lift:.2g} of a texel")


def shadowed(g: np.random.Generator) -> Swept:
    """Lit or not, against rays in steps of 1/32 texel.

    A wrong answer's error is how deep below or high above the surface its ray came closest, as
    a share of what the method states: a quarter of the largest twist of a cell.
    """
    relief, (u, v), lift = _field(g)
    height = relief.at(u, v)
    direction = _directions(g, 0.05)
    lit = loop_calls.lit(relief, (u, v), height, direction, None)
    x, y, z = (c.astype(np.float64) for c in direction)
    run = np.hypot(x, y)
    reach = float(((relief.high - height) / z * run).max()) / relief.texel_size
    start = _surface(relief, u, v) + _LIFT * (relief.high - relief.low)
    clear = np.full(u.shape, np.inf)
    for step in range(1, max(2, math.ceil(_FINE * reach))):
        along = step / _FINE * relief.texel_size / np.maximum(run, 1e-9)
        rise = start + along * z - _surface(relief, u + along * x, v + along * y)
        clear = np.minimum(clear, np.where(start + along * z <= relief.high, rise, np.inf))
    field = relief.heights.reshape(relief.texture.size[1], relief.texture.size[0])
    right, below = np.roll(field, -1, 1), np.roll(field, -1, 0)
    twist = float(np.abs(field + np.roll(right, -1, 0) - right - below).max())
    stated = twist / 4.0 + 2.0 * _LIFT * (relief.high - relief.low)
    wrong = lit != (clear > 0.0)
    error = np.where(wrong, np.abs(clear), 0.0) / max(stated, 1e-30)
    return compared(error, np.zeros_like(error), 1.0, f"relief {lift:.2g} of a texel")


def _field(g: np.random.Generator) -> tuple[Relief, tuple[Values, Values], float]:
    """A height field, places on it, and its relief in texels."""
    width, height = (int(side) for side in g.integers(3, 24, 2))
    lift = float(log_uniform(g, 1e-4, 8.0))
    texture = _textured(g, width, height, lift=lift)
    relief = Relief(texture, 1.0, 1.0)
    extent = texture.extent
    return (
        relief,
        (g.uniform(-extent[0], extent[0], _RAYS), g.uniform(-extent[1], extent[1], _RAYS)),
        lift,
    )


def _directions(g: np.random.Generator, lowest: float) -> Vec:
    z = g.uniform(lowest, 1.0, _RAYS).astype(np.float32)
    around = g.uniform(0.0, 2.0 * math.pi, _RAYS)
    ring = np.sqrt(1.0 - z.astype(np.float64) ** 2)
    x, y = (ring * np.cos(around)).astype(np.float32), (ring * np.sin(around)).astype(np.float32)
    return x, y, z


def _surface(relief: Relief, u: Values, v: Values) -> Values:
    """The bilinear surface, float64."""
    width, height = relief.texture.size
    field = relief.heights.reshape(height, width).astype(np.float64)
    column = u / relief.texel_size + (width - 1) / 2.0
    row = (height - 1) / 2.0 - v / relief.texel_size
    left, above = np.floor(column), np.floor(row)
    fx, fy = column - left, row - above
    x0, y0 = np.mod(left.astype(int), width), np.mod(above.astype(int), height)
    x1, y1 = (x0 + 1) % width, (y0 + 1) % height
    upper = field[y0, x0] * (1.0 - fx) + field[y0, x1] * fx
    lower = field[y1, x0] * (1.0 - fx) + field[y1, x1] * fx
    return np.asarray(upper * (1.0 - fy) + lower * fy)


def _textured(
    g: np.random.Generator,
    width: int,
    height: int,
    *,
    slope: float = 0.0,
    lift: float = 0.0,
    even: bool = False,
) -> Texture:
    """Random maps; heights of so many texels, slopes of such a size."""

    def field(planes: int) -> NDArray[np.float32]:
        drawn = g.random((planes, 1, 1) if even else (planes, height, width))
        return np.broadcast_to(drawn, (planes, height, width)).astype(np.float32)

    texel = float(log_uniform(g, 1e-3, 1.0))
    slopes = np.float32(slope) * (2.0 * field(2) - 1.0)
    return Texture(field(3), field(1), field(1), np.float32(lift * texel) * field(1), slopes, texel)
