"""Detection of the flash's highlight: position, width, contrast; what is left of it in albedo.

The same measurement is made in a photograph and its re-rendering, to compare them: on a grid of
cells, with medians over rings, robust to texture and glints, and without a reflectance model. The
re-rendering is clipped at the photograph's level, so that both peaks are flattened alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.photo.left_out import area_averaged
from matcap.photo.photo import Photo

Luminance = NDArray[np.float64]
Floats = NDArray[np.float32]

CELLS = 256  # across the long side: a spot of 0.4 % of it is one cell
SURROUNDINGS = (0.5, 0.7)  # plane units from the centre: outside most highlights

# Settings of the detection of the highlight; docs/notes/capture.md.

_RING = 0.02  # width of a ring, plane units; glints are blurred by twice it for the first centre
FAINTEST_HIGHLIGHT = 1.3  # least peak over the quantile _USUAL of the surroundings
# Quantile of the surroundings that a peak is compared with. It is high, so that the bright squares
# of a plaid do not count as highlights.
_USUAL = 0.9
_TOP = 0.3  # share of the peak's height, from the top, whose centroid is the centre
_ROUNDS = 8  # iterations of the centre
# The picture is tried as it is, then with this many blurs until the spot is the only bright one:
# the first of standard deviation _TEXTURE, plane units, each twice the last.
_TEXTURE, _BLURS = 0.015, 4
# Pairs (a, b): a spot is texture if the area elsewhere that is brighter than its surroundings plus
# a times its height is at least b times its own. Of a flake of bare metal in the wide highlight of
# rust, that area is 0 at a = 0.5, but not at 0.25.
_OTHERS = ((0.5, 0.25), (0.25, 2.5))

# What is left of the highlight in albedo.
_ALBEDO_CELLS = (
    128  # along the long side, over which log albedo is averaged; finer detail is texture
)
_RING_WIDTH = 2  # of a ring, cells
_WIDEST = 20  # radius of the largest ring, cells; wider discs are shading, which `flatten` removes
_MISSED = 2  # rings in a row that do not stand out, at which the disc ends
_AROUND = 3 * _RING_WIDTH  # width of the ring around the largest, cells
_INSIDE = 0.9  # least share of a ring inside the picture, at other centres
_NEAR = 12  # farthest centre of a disc of the highlight from the mirror point, cells
_OUTLIER = 4.0  # deviations from the mean over other centres at which a ring stands out

# Most standard deviation of the blur that removes texture from the elongation, plane units.
_ELONGATION_BLUR = 0.03

# Sparkles: samples across the long side, of which 5 x 5 give a local median, times that median
# from which on light above white is one. A highlight whose half width is below the window of the
# median, plane units, is exempt within so many of them.
_SAMPLES, _SPARKLE, _EXEMPT, _NARROW = 256, 3.0, 1.5, 0.03


@dataclass(frozen=True)
class Highlight:
    """A detected highlight."""

    centre: tuple[float, float]
    """Image coordinates (u right, v up; the long side in [-1, 1])."""
    width: float
    """Radius at which radiance is half-way between peak and surroundings, plane units."""
    peak: float
    """Radiance at its centre, at most the clip level."""
    surroundings: float
    """Radiance at 0.5 to 0.7 plane units from the centre."""

    @property
    def contrast(self) -> float:
        """Peak over surroundings."""
        return self.peak / self.surroundings


def light_of(pixels: NDArray[np.float32]) -> Luminance:
    """(h, w) mean of the channels (H, W, 3) on a grid CELLS across."""
    height, width = pixels.shape[:2]
    size = (CELLS, max(8, round(CELLS * height / width)))
    how = cv2.INTER_AREA if width >= CELLS else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(pixels, size, interpolation=how).mean(axis=2), np.float64)


def find_highlight(light: Luminance) -> Highlight | None:
    """The brightest smooth spot of a linear picture (h, w); None without a distinct one.

    If other spots are as bright (bare metal between rust, pale leaves), the picture is blurred
    more and more until there is only one, or none.
    """
    cell = 2.0 / light.shape[1]
    spot = None
    for texture in (0.0, *(_TEXTURE * 2.0**k for k in range(_BLURS))):
        blurred = _blur(light, texture / cell) if texture else light
        spot = _brightest(blurred)
        if spot is None or all(_others(blurred, spot, at) < most for at, most in _OTHERS):
            break
    return spot


def limit_sparkles(photo: Photo) -> Photo:
    """The photograph with lone sparkles as lower bounds, as a file that clips at white has them.

    A fleck of metal or a bump that mirrors the flash is many times as bright as all around it.
    Means over cells, rings and the picture, which the fits compare, would be the sparkles'. So
    light above white that exceeds _SPARKLE times its local median is clipped there, but for a sharp
    highlight.
    """
    if photo.headroom <= 1.0:
        return photo
    brightest = photo.pixels.max(axis=2)
    height, width = brightest.shape
    size = (min(width, _SAMPLES), max(8, round(min(width, _SAMPLES) * height / width)))
    samples = cv2.resize(brightest, size, interpolation=cv2.INTER_NEAREST)
    median = cv2.resize(cv2.medianBlur(samples, 5), (width, height))
    limit = np.maximum(_SPARKLE * median, 1.0)
    highlight = find_highlight(light_of(photo.pixels))
    if highlight is not None and highlight.width < _NARROW:
        u, v = (c - at for c, at in zip(_coordinates(brightest), highlight.centre, strict=True))
        limit[np.hypot(u, v) < _EXEMPT * highlight.width] = np.inf
    sparkles = brightest > limit
    if not sparkles.any():
        return photo
    pixels = np.minimum(photo.pixels, limit[..., None])
    return replace(photo, pixels=pixels, clipped=photo.clipped | sparkles)


def elongation(light: Luminance, highlight: Highlight) -> float:
    """Length over width of a highlight, above half of its peak.

    Args:
        light: (h, w) the linear picture.
    """
    blur = min(_ELONGATION_BLUR, 0.3 * highlight.width)
    blurred = _blur(light, blur * light.shape[1] / 2.0)
    u, v = (c - at for c, at in zip(_coordinates(light), highlight.centre, strict=True))
    half = 0.5 * (highlight.peak + highlight.surroundings)
    over = np.clip(blurred - half, 0.0, highlight.peak - half)
    over = over * (np.hypot(u, v) < 3.0 * highlight.width)
    if over.sum() <= 0.0:
        return 1.0
    offsets = np.stack([each.ravel() for each in np.broadcast_arrays(u, v)])
    small, large = np.linalg.eigvalsh(np.cov(offsets, aweights=over.ravel())).clip(1e-9)
    return float(np.sqrt(large / small))


def _others(light: Luminance, spot: Highlight, height: float) -> float:
    """Area outside of a highlight above a share of its height, over its own area."""
    distance = np.hypot(*(c - at for c, at in zip(_coordinates(light), spot.centre, strict=True)))
    level = spot.surroundings + height * (spot.peak - spot.surroundings)
    elsewhere = (light > level) & (distance > 2.0 * spot.width) & (distance < SURROUNDINGS[1])
    return float(elsewhere.sum() * (2.0 / light.shape[1]) ** 2 / (np.pi * spot.width**2))


def _coordinates(light: Luminance) -> tuple[Luminance, Luminance]:
    """Image coordinates of columns (1, w) and of rows (h, 1)."""
    height, width = light.shape
    u = (np.arange(width) + 0.5) * 2.0 / width - 1.0
    v = (height - 2.0 * (np.arange(height) + 0.5)) / width
    return u[None, :], v[:, None]


def _brightest(light: Luminance) -> Highlight | None:
    """The brightest spot, or None if its contrast is too small."""
    cell = 2.0 / light.shape[1]
    u, v = (c.ravel() for c in _coordinates(light))
    smooth = _blur(light, 2.0 * _RING / cell)
    row, column = np.unravel_index(int(smooth.argmax()), smooth.shape)
    centre, reach = np.array([u[column], v[row]]), 2.0 * _RING
    for _ in range(_ROUNDS):
        distance = np.hypot(u[None, :] - centre[0], v[:, None] - centre[1])
        profile = _profile(light, distance, reach)
        if profile is None:
            return None
        peak, surroundings, half = profile
        # Centroid of the light near the top, clamped to the peak; lower levels would shift it
        # towards brighter surroundings.
        high = peak - _TOP * (peak - surroundings)
        over = np.clip(_blur(light, 0.25 * half / cell) - high, 0.0, peak - high)
        over = over * (distance < 1.2 * half + 2.0 * cell)
        if over.sum() <= 0.0:
            return None
        moved = np.array([(over * u[None, :]).sum(), (over * v[:, None]).sum()]) / over.sum()
        reach = max(0.35 * half, 1.5 * cell)
        done = float(np.hypot(*(moved - centre))) < 0.1 * cell
        centre = moved
        if done:
            break
    surroundings = max(surroundings, 1e-6)
    ring = (distance > SURROUNDINGS[0]) & (distance < SURROUNDINGS[1])
    if peak < FAINTEST_HIGHLIGHT * float(np.quantile(light[ring], _USUAL)):
        return None
    return Highlight((float(centre[0]), float(centre[1])), half, peak, surroundings)


def _profile(
    light: Luminance, distance: Luminance, reach: float
) -> tuple[float, float, float] | None:
    """Peak, surroundings and half-way radius about a centre; None without the latter.

    Args:
        light: (h, w) linear picture.
        distance: (h, w) from the centre, plane units.
        reach: radius of the disc whose median is the peak.
    """
    ring = (distance < SURROUNDINGS[1]) & (distance > SURROUNDINGS[0])
    if not ring.any():
        return None
    surroundings = float(np.median(light[ring]))
    inner = distance < max(reach, float(distance.min()))
    peak = float(np.median(light[inner])) if inner.any() else float(light.flat[distance.argmin()])
    middle = 0.5 * (peak + surroundings)
    # Medians over rings, from the centre outwards.
    last_radius, last = 0.0, peak
    step = min(_RING, 0.5 * max(reach, _RING / 2.0))
    for k in range(1, int(SURROUNDINGS[0] / step) + 1):  # beyond, it is the flash's falloff
        radius = k * step
        inside = (distance >= radius - 0.5 * step) & (distance < radius + 0.5 * step)
        if not inside.any():
            continue
        value = float(np.median(light[inside]))
        if value < middle:
            share = float(np.clip((last - middle) / max(last - value, 1e-12), 0.0, 1.0))
            return peak, surroundings, last_radius + share * (radius - last_radius)
        last_radius, last = radius, value
    return None


def _blur(light: Luminance, deviation: float) -> Luminance:
    """Gaussian blur; the deviation is in cells, at least 0.3."""
    return np.asarray(
        cv2.GaussianBlur(light, (0, 0), max(deviation, 0.3), borderType=cv2.BORDER_REFLECT_101)
    )


def remaining_highlight(
    albedo: Floats, known: NDArray[np.bool_], distance: Floats
) -> NDArray[np.bool_]:
    """(H, W) bool: texels around the mirror point whose albedo still has the highlight.

    What the fitted lobe misses of a highlight is put into albedo: a white spot, or a ring. A
    material does not know where the flash was, so the mean of log albedo over a ring around the
    mirror point is compared with the means over equal rings around other centres. The result is the
    disc up to the last ring that stands out, before two that do not: rings that stand out only
    farther away are shading. A narrow core may lie off the fitted mirror point, or be long: small
    discs near it that stand out more than any elsewhere are added.

    Args:
        albedo: (C, H, W) diffuse albedo, in (0, 1].
        known: (H, W) bool, texels of the photograph, clipped ones included.
        distance: (H, W) distance from the mirror point, texels.
    """
    step = max(1, max(known.shape) // _ALBEDO_CELLS)
    size = (known.shape[1] // step, known.shape[0] // step)
    log = np.log(np.maximum(albedo, 1e-3)).mean(0) * known
    total, share, distances = (
        area_averaged(plane, size) for plane in (log, known.astype(np.float32), distance / step)
    )
    surroundings = _ring_means(total, share, _WIDEST, _WIDEST + _AROUND)
    inner = range(0, _WIDEST, _RING_WIDTH)
    rings = [_z_scores(total, share, surroundings, distances, each) for each in inner]
    centre = np.unravel_index(int(distances.argmin()), distances.shape)
    radius = _radius([float(ring[centre]) for ring in rings]) if distances[centre] <= 1.0 else 0
    discs = np.nan_to_num(rings[0])
    spots = (distances <= _NEAR) & (discs > discs[distances > _WIDEST].max(initial=_OUTLIER))
    grown = cv2.dilate(spots.astype(np.uint8), np.ones((2 * _RING_WIDTH + 1,) * 2, np.uint8))
    texels = cv2.resize(grown, known.shape[::-1], interpolation=cv2.INTER_NEAREST) > 0
    return np.asarray(texels | ((distance < (radius + 1) * step) & (radius > 0)))


def _radius(scores: list[float]) -> int:
    """Outer radius in cells of the last ring that stands out, before two that do not; or 0."""
    radius = missed = 0
    for number, contrast in enumerate(scores):
        if contrast > _OUTLIER:
            radius, missed = (number + 1) * _RING_WIDTH, 0
        elif np.isfinite(contrast):
            missed += 1
            if missed == _MISSED:
                break
    return radius


def _z_scores(
    total: Floats, share: Floats, surroundings: Floats, distances: Floats, inner: int
) -> Floats:
    """(h, w) how far the contrast of the ring around each cell is from its mean over those far from
    the mirror point, in their standard deviations; NaN where it is unknown.

    Args:
        total: (h, w) sums of log albedo over cells.
        share: (h, w) known share of the cells.
        surroundings: (h, w) mean over the ring around the largest disc, NaN where unknown.
        distances: (h, w) distance of the cells from the mirror point, cells.
        inner: inner radius of the ring, cells.
    """
    outer = inner + _RING_WIDTH
    contrast = _ring_means(total, share, inner, outer) - surroundings
    others = contrast[np.isfinite(contrast) & (distances > _WIDEST + outer)]
    if len(others) < 16:
        return np.full_like(contrast, np.nan)
    return np.abs((contrast - others.mean()) / (others.std() + 1e-3)).astype(np.float32)


def _ring_means(total: Floats, share: Floats, inner: int, outer: int) -> Floats:
    """(h, w) means over the ring around each cell; NaN where much of it is outside the picture."""
    radius = np.hypot(*np.ogrid[-outer : outer + 1, -outer : outer + 1])
    ring = ((radius >= inner) & (radius < outer)).astype(np.float32)
    border = cv2.BORDER_CONSTANT
    sums, counts = (cv2.filter2D(each, -1, ring, borderType=border) for each in (total, share))
    return np.where(counts > _INSIDE * ring.sum(), sums / np.maximum(counts, 1e-6), np.nan)
