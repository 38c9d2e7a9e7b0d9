"""Detection of the flash's highlight: place, width and contrast.

The same measurement is made in a photograph and its re-rendering, to compare them: on a grid of
cells, with medians over rings, robust to texture and glints, and without a reflectance model. The
re-rendering is clipped at the photograph's level, so that both peaks are flattened alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Luminance = NDArray[np.float64]

CELLS = 256  # across the long side: a spot of four pixels in a thousand is still a cell
SURROUNDINGS = (0.5, 0.7)  # plane units from the centre: outside most highlights


@dataclass(frozen=True)
class HighlightSettings:
    """Settings of the detection; docs/notes/capture.md."""

    seed_blur: float = 0.04
    """Plane units, deviation: a glint is smaller, a highlight is not."""
    ring: float = 0.02
    """Plane units, width of one."""
    widest: float = 0.5
    """Plane units: a half width beyond this is the falloff itself."""
    faintest: float = 1.3
    usual: float = 0.9
    """The faintest highlight's peak over what of the surroundings so large a share is darker than:
    a white square of a plaid is no highlight."""
    top: float = 0.3
    """Of the way down from the peak, what its centre is the centroid of."""
    rounds: int = 8
    """Of moving the centre."""
    textures: tuple[float, ...] = (0.0, 0.015, 0.03, 0.06, 0.12)
    """Plane units, deviations: how far texture is blurred away until the spot is the only one."""
    others: float = 0.25
    """Area as bright beyond two half widths, of the spot's own, that makes it texture."""


HIGHLIGHT = HighlightSettings()


@dataclass(frozen=True)
class Highlight:
    """A highlight."""

    centre: tuple[float, float]
    """Image coordinates (u right, v up; the long side in [-1, 1])."""
    width: float
    """Radius at which light is half-way between peak and surroundings, plane units."""
    peak: float
    """Light in its middle, no more than the picture's clip level."""
    surroundings: float
    """Light 0.5 to 0.7 plane units away."""

    @property
    def contrast(self) -> float:
        """Peak over surroundings."""
        return self.peak / self.surroundings


def light_of(pixels: NDArray[np.float32], cells: int = CELLS) -> Luminance:
    """(h, w) mean of the channels (H, W, 3) on a grid `cells` across."""
    height, width = pixels.shape[:2]
    size = (cells, max(8, round(cells * height / width)))
    how = cv2.INTER_AREA if width >= cells else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(pixels, size, interpolation=how).mean(axis=2), np.float64)


def find_highlight(light: Luminance) -> Highlight | None:
    """The brightest smooth spot of a picture (h, w), linear; None where none stands out.

    Where several spots are as bright (bare metal between rust, pale leaves), the spot is sought in
    the low-pass filtered picture instead, and rejected if none stands out there.
    """
    cell = 2.0 / light.shape[1]
    spot = None
    for texture in HIGHLIGHT.textures:
        blurred = _blur(light, texture / cell) if texture else light
        spot = _brightest(blurred)
        if spot is None or _others(blurred, spot) < HIGHLIGHT.others:
            break
    return spot


def _others(light: Luminance, spot: Highlight) -> float:
    """Area elsewhere that is as bright as a highlight's half-way ring, in areas of that ring."""
    distance = np.hypot(*(c - at for c, at in zip(_coordinates(light), spot.centre, strict=True)))
    middle = 0.5 * (spot.peak + spot.surroundings)
    elsewhere = (light > middle) & (distance > 2.0 * spot.width) & (distance < SURROUNDINGS[1])
    return float(elsewhere.sum() * (2.0 / light.shape[1]) ** 2 / (np.pi * spot.width**2))


def _coordinates(light: Luminance) -> tuple[Luminance, Luminance]:
    """Image coordinates of columns (1, w) and of rows (h, 1)."""
    height, width = light.shape
    u = (np.arange(width) + 0.5) * 2.0 / width - 1.0
    v = (height - 2.0 * (np.arange(height) + 0.5)) / width
    return u[None, :], v[:, None]


def _brightest(light: Luminance) -> Highlight | None:
    """The brightest spot, as it is."""
    width = light.shape[1]
    cell = 2.0 / width
    u, v = (c.ravel() for c in _coordinates(light))
    smooth = _blur(light, HIGHLIGHT.seed_blur / cell)
    row, column = np.unravel_index(int(smooth.argmax()), smooth.shape)
    centre, profile = np.array([u[column], v[row]]), None
    reach = 2.0 * HIGHLIGHT.ring
    for _ in range(HIGHLIGHT.rounds):
        distance = np.hypot(u[None, :] - centre[0], v[:, None] - centre[1])
        profile = _profile(light, distance, reach)
        if profile is None:
            return None
        peak, surroundings, half = profile
        # Light near the top, none of it counting for more than the peak: lower down, what is around
        # the highlight pulls it to the brighter side.
        high = peak - HIGHLIGHT.top * (peak - surroundings)
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
    if profile is None:
        return None
    peak, surroundings, half = profile[0], max(profile[1], 1e-6), profile[2]
    ring = (distance > SURROUNDINGS[0]) & (distance < SURROUNDINGS[1])
    if peak < HIGHLIGHT.faintest * float(np.quantile(light[ring], HIGHLIGHT.usual)):
        return None
    return Highlight((float(centre[0]), float(centre[1])), half, peak, surroundings)


def _profile(
    light: Luminance, distance: Luminance, reach: float
) -> tuple[float, float, float] | None:
    """Peak, surroundings and the radius half-way between them; None without one."""
    ring = (distance < SURROUNDINGS[1]) & (distance > SURROUNDINGS[0])
    if not ring.any():
        return None
    surroundings = float(np.median(light[ring]))
    inner = distance < max(reach, float(distance.min()))
    peak = float(np.median(light[inner])) if inner.any() else float(light.flat[distance.argmin()])
    middle = 0.5 * (peak + surroundings)
    # Medians of rings, the first of them a disc, from the middle outwards.
    last_radius, last = 0.0, peak
    step = min(HIGHLIGHT.ring, 0.5 * max(reach, HIGHLIGHT.ring / 2.0))
    for k in range(1, int(HIGHLIGHT.widest / step) + 1):
        radius = k * step
        inside = (distance >= radius - 0.5 * step) & (distance < radius + 0.5 * step)
        if not inside.any():
            continue
        value = float(np.median(light[inside]))
        if value < middle:
            share = (last - middle) / max(last - value, 1e-12)
            return (
                peak,
                surroundings,
                last_radius + float(np.clip(share, 0.0, 1.0)) * (radius - last_radius),
            )
        last_radius, last = radius, value
    return None


def _blur(light: Luminance, deviation: float) -> Luminance:
    return np.asarray(
        cv2.GaussianBlur(light, (0, 0), max(deviation, 0.3), borderType=cv2.BORDER_REFLECT_101)
    )
