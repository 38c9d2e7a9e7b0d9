"""Sheets: felt, looped carpet, paper, creased foil or cloth, tread plate."""

from __future__ import annotations

import cv2
import numpy as np

from matcap_lab.simulate.materials.draws import METALS, Draws, Integers
from matcap_lab.simulate.materials.kinds.place import frame, paths, rotated, scatter, splat
from matcap_lab.simulate.materials.kinds.surface_fields import SurfaceFields
from matcap_lab.simulate.procedural import (
    Canvas,
    Raster,
    Spectrum,
    bumps,
    cells,
    noise,
    pick,
    smoothstep,
)


def felt(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Wavy fibres over one another: felt, fleece, coir."""
    width = rng.log_uniform(0.005, 0.012)
    pieces, step = 14, width * rng.uniform(1.5, 3.5)
    curl, loose = rng.uniform(0.1, 0.5), rng.choice([0.3, 3.0, 3.0])
    favoured = rng.uniform(0, np.pi)

    pitch = np.sqrt(width * pieces * step) * rng.uniform(0.75, 1.1)
    x, y, turn, whose = paths(canvas, "fibres", pitch, pieces, step, curl, (favoured, loose))
    reach = np.full(x.size, 0.5 * step + 1.5 * width)
    own = canvas.stream("own")
    count = int(whose.max()) + 1
    level, slant = own.random(count), own.standard_normal(count)
    thick = width * (0.6 + 0.8 * own.random(count))
    order = np.arange(x.size) % pieces / (pieces - 1.0) - 0.5

    def profile(dx: Raster, dy: Raster, which: Integers) -> Raster:
        u, v = rotated(dx, dy, turn[which])
        chain = whose[which]
        far = np.hypot(np.maximum(np.abs(u) - 0.5 * step, 0.0), v) / thick[chain]
        place = order[which] + u / (pieces * step)
        high = width * (2.5 * level[chain] + 1.5 * slant[chain] * place)
        high = high + thick[chain] * np.sqrt(np.maximum(1.0 - far**2, 0.0))
        return np.where(far < 1.0, high, -np.inf)

    height, index = splat(canvas, x, y, reach, profile, -width)
    fibre = whose[index]
    tones = rng.shades(rng.dye(), 9, rng.choice([0.05, 0.2, 0.5]))
    if rng.chance(0.2):
        tones = np.concatenate([tones, rng.shades(rng.dye(), 5, 0.2)])
    diffuse = pick(tones, own.random(count)[fibre])
    rough = rng.uniform(0.5, 0.92) + 0.03 * own.standard_normal(count)[fibre]
    cavity = smoothstep(3.0 * width, -1.0 * width, height)
    return SurfaceFields(diffuse, rng.dielectric(), rough, height, cavity)


def loops(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Tufts in loose rows, each a small arch of yarn: carpet, terry, boucle."""
    size = rng.log_uniform(0.018, 0.06)
    thick = rng.uniform(0.28, 0.45)
    favoured, loose = rng.uniform(0.0, np.pi), rng.choice([0.25, 0.8, 3.0])

    x, y, sizes = scatter(canvas, "tufts", size * rng.uniform(0.55, 0.8))
    count = x.size
    reach = size * (0.8 + 0.4 * sizes.random(count))
    own = canvas.stream("own")
    turn = favoured + loose * own.standard_normal(count)
    level, bow = 0.5 * own.random(count), 0.3 * own.standard_normal(count)

    def profile(dx: Raster, dy: Raster, which: Integers) -> Raster:
        u, v = rotated(dx, dy, turn[which])
        u, v = u / reach[which], v / reach[which]
        far = (v - bow[which] * (1.0 - u * u)) / thick
        arch = 1.0 - u * u
        body = 1.0 - far * far
        high = 0.9 * np.sqrt(np.maximum(arch, 0.0)) + thick * np.sqrt(np.maximum(body, 0.0))
        return np.where((arch > 0.0) & (body > 0.0), high + level[which], -np.inf)

    height, index = splat(canvas, x, y, reach, profile, 0.0)
    index = np.maximum(index, 0)
    u, v = rotated(canvas.x - x[index], canvas.y - y[index], turn[index])
    twist = np.sin((u / size + v / size) * rng.uniform(8.0, 16.0)) * (size > 0.03)
    tones = rng.shades(rng.dye(), 9, rng.choice([0.03, 0.12, 0.35]))
    if rng.chance(0.3):
        tones = np.concatenate([tones, rng.shades(rng.dye(), 3, 0.1)])
    diffuse = pick(tones, own.random(count)[index]) * np.exp(0.06 * twist)
    rough = rng.uniform(0.55, 0.92) + 0.04 * own.standard_normal(count)[index]
    cavity = smoothstep(1.2, 0.1, height)
    return SurfaceFields(diffuse, rng.dielectric(), rough, size * (height + 0.03 * twist), cavity)


def tread(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """A repeated embossed motif: tread plate, studded rubber, embossed card."""
    size = rng.log_uniform(0.04, 0.15)
    along, across = frame(canvas, "tread", rng.angle(), 4.0 * size, 0.0)
    u, v = along / size, across / size
    brick = rng.chance(0.5)
    row = np.floor(v).astype(np.int64)
    u = u + 0.5 * (row % 2) * brick
    column = np.floor(u).astype(np.int64)
    x, y = 2.0 * (u - column) - 1.0, 2.0 * (v - row) - 1.0
    crossed = (column + row) % 2 == 0
    x, y = np.where(crossed, x, y), np.where(crossed, y, x)
    large, edge = rng.uniform(0.5, 0.8), rng.uniform(0.05, 0.4)
    motif = rng.integers(5)
    if motif == 0:  # lens-shaped bars
        far = np.maximum(np.abs(x) / 0.9, (np.abs(y) / (0.35 * large) + x * x) * 0.8)
    elif motif == 1:  # studs
        far = np.hypot(x, y) / large
    elif motif == 2:  # pyramids
        far = np.maximum(np.abs(x), np.abs(y)) / large
    elif motif == 3:  # diamonds
        far = (np.abs(x) + 0.6 * np.abs(y)) / large
    else:  # rings
        far = np.abs(np.hypot(x, y) - 0.6) / (0.35 * large)
    raised = smoothstep(0.0, edge, 1.0 - far) * (1.0 if rng.chance(0.75) else -1.0)
    metal = rng.chance(0.4)
    hue = rng.natural(METALS) if metal else rng.dye()
    dirt = noise(canvas, "dirt", Spectrum(0.15, 0.015, slope=1.2))
    low = smoothstep(0.4, -0.2, raised) if raised.max() > 0.0 else smoothstep(-0.4, -1.0, raised)
    worn = rng.uniform(0.0, 0.2)
    diffuse = hue[:, None, None] * np.exp(rng.uniform(0.02, 0.25) * dirt)
    specular = rng.uniform(0.5, 0.85) if metal else rng.dielectric()
    gloss = rng.uniform(0.15, 0.45) if metal else rng.uniform(0.15, 0.85)
    return SurfaceFields(diffuse, specular, gloss + 0.03 * dirt + worn * low, size * raised, low)


def paper(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """Flat stock with flecks and cloudy formation: paper, card, vinyl."""
    stock = np.clip(rng.dye() if rng.chance(0.5) else rng.shade(np.full(3, 0.7), 0.15), 0.02, 0.88)
    cloud = noise(canvas, "cloud", Spectrum(0.05, 0.015, slope=0.8))
    length = rng.log_uniform(4.0, 10.0)
    flock = np.full((canvas.height, canvas.width), -4.0)
    start = rng.uniform(0.0, np.pi)
    for k in range(5):
        spectrum = Spectrum(0.02, 0.005, 0.2, stretch=length, angle=start + k * np.pi / 5)
        flock = np.maximum(flock, noise(canvas, f"flock {k}", spectrum))
    fleck = smoothstep(2.2, 2.8, noise(canvas, "fleck", Spectrum(0.02, 0.006, slope=0.0)))
    ink = rng.shade(stock, 1.0, 0.4)[:, None, None]
    share = rng.choice([0.0, 0.8]) * fleck
    diffuse = stock[:, None, None] * np.exp(rng.uniform(0.01, 0.08) * (cloud + flock))
    diffuse = diffuse + share * (ink - diffuse)
    rough = rng.choice([rng.uniform(0.15, 0.4), rng.uniform(0.5, 0.9)]) + 0.015 * flock
    height = 0.3 * cloud * rng.random() + rng.uniform(0.2, 1.0) * flock
    if rng.chance(0.3):  # laid or embossed
        _, across = frame(canvas, "laid", rng.uniform(0.0, np.pi), 0.5, 0.0)
        height = height + 1.2 * np.sin(2.0 * np.pi * across / rng.log_uniform(0.015, 0.05))
    cavity = smoothstep(0.0, -2.0, height)
    return SurfaceFields(diffuse, rng.dielectric(), rough, 0.002 * height, cavity)


def creased(canvas: Canvas, rng: Draws) -> SurfaceFields:
    """A sheet crumpled into facets and smoothed again: paper, foil, cloth."""
    size = rng.log_uniform(0.06, 0.16)
    height = _facets(canvas, "large", 1.6 * size)
    for k, share in enumerate(rng.uniform(0.1, 0.7, size=2)):
        height = height + 0.6 ** (k + 1) * share * _facets(canvas, f"small {k}", 0.6**k * size)
    soft = 0.02 * size * bumps(canvas, "soft", Spectrum(size, 0.4 * size))
    ridge, valley = _folds(canvas, size * height, 0.004)
    fold = np.maximum(ridge, valley)
    foil = rng.chance(0.3)
    hue = rng.natural(METALS) if foil else rng.dye()
    fibre = noise(canvas, "fibre", Spectrum(0.03, 0.006, slope=0.5))
    rubbed = rng.uniform(-0.4, 0.6)
    diffuse = hue[:, None, None] * np.exp(0.04 * fibre + rubbed * fold)
    specular = rng.uniform(0.5, 0.9) if foil else rng.dielectric()
    gloss = rng.uniform(0.15, 0.4) if foil else rng.uniform(0.25, 0.85)
    rough = gloss + rng.uniform(0.0, 0.15) * fold + 0.02 * fibre
    return SurfaceFields(diffuse, specular, rough, size * 0.3 * height + soft, valley)


def _facets(canvas: Canvas, label: str, size: float) -> Raster:
    """(H, W) pyramids over random cells, of random height and sign, in units of `size`."""
    cell = cells(canvas, label, size)
    return cell.border * (2.0 * cell.draw(canvas.stream(label + " rise")) - 1.0)


def _folds(canvas: Canvas, height: Raster, width: float) -> tuple[Raster, Raster]:
    """Masks (0 to 1) of convex and concave creases of a faceted height; `width` in plane units."""
    deviation = width / canvas.texel_size
    smooth = cv2.GaussianBlur(height, (0, 0), deviation, borderType=cv2.BORDER_REFLECT)
    curvature: Raster = np.asarray(cv2.Laplacian(smooth, cv2.CV_64F), np.float64)
    curvature /= canvas.texel_size**2
    scale = 0.4 / width  # a fold of slope 1, blurred
    return smoothstep(0.2, 1.0, -curvature / scale), smoothstep(0.2, 1.0, curvature / scale)
