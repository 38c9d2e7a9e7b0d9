"""Highlight contrast and glint contrast, re-rendered over photographed.

Both pictures are clipped at the photograph's clip level, then averaged in rings around the mirror
point and divided by M, a uniform matte surface under the same flash. With <> a mean over texels,

    profile(r) = <L>_r / <M>_r,    contrast = profile(r < NEAR) / profile(r > FAR),

and 1 is a matte surface. Glint contrast is the standard deviation of log L in octaves of spatial
frequency, where the specular fraction of the photograph is at least MIRRORED.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.capture.exemplar.filters import filled
from matcap.capture.exemplar.mean_parameters import BOUND
from matcap.capture.exemplar.refine import LEAST_SHARE, MIRRORED
from matcap.flash.geometry import FlashSetup, flash_mirror_point, plane_points
from matcap.flash.highlight import FAINTEST_HIGHLIGHT
from matcap.flash.light import FlashLight, cached_rows, strips
from matcap.photo.inspect import channel_mean

Picture = NDArray[np.float32]
TexelMask = NDArray[np.bool_]

NEAR, FAR = 0.06, 0.3  # plane units from the mirror point
_EDGES = (0.0, NEAR, 0.085, 0.12, 0.17, 0.24, FAR, 9.0)  # radii, plane units; two rings per octave
UNSEEN = 0.01  # standard deviation of log radiance that is invisible
_OCTAVES = 3  # number, from 1 texel on
_DARKEST = 1e-4  # radiance below which logarithms are clamped


@dataclass(frozen=True)
class HighlightProfile:
    """A highlight in photograph and re-rendering, clipped alike; pairs are in this order."""

    rings: tuple[tuple[float, float], ...]
    """By ring from the innermost: profile(r) over that of the outermost; the first is the
    contrast."""
    clipped: tuple[float, ...]
    """By ring: share that is clipped in the photograph."""
    glints: tuple[tuple[float, float], ...] = ()
    """By octave, finest first: standard deviation of log radiance; empty without a highlight."""

    @property
    def contrast(self) -> tuple[float, float]:
        """Highlight contrast (module equation) of photograph and re-rendering; 1 is matte."""
        return self.rings[0]

    @property
    def glossy(self) -> bool:
        """Whether either picture has a highlight."""
        return max(self.contrast) >= FAINTEST_HIGHLIGHT

    @property
    def bound(self) -> bool:
        """Whether the photographed contrast is only a lower bound, as its core is clipped."""
        return self.clipped[0] > BOUND

    @property
    def ratio(self) -> float:
        """Highlight contrast, re-rendered over photographed; NaN if neither is glossy.

        If the core is clipped, the innermost unclipped ring of the highlight is compared as well;
        the ratio farther from 1 is returned.
        """
        if not self.glossy:
            return math.nan
        measured = (
            after / before
            for (before, after), clipped in zip(self.rings, self.clipped, strict=True)
            if clipped <= BOUND and max(before, after) >= FAINTEST_HIGHLIGHT
        )
        core = self.contrast[1] / self.contrast[0]
        return max((core, next(measured, core)), key=lambda ratio: abs(math.log(ratio)))

    @property
    def glint_ratio(self) -> float:
        """Glint contrast of all octaves, re-rendered over photographed; NaN without a highlight.

        UNSEEN, the visibility threshold, is added to both in quadrature.
        """
        if not self.glints:
            return math.nan
        before, after = (math.hypot(UNSEEN, *each) for each in zip(*self.glints, strict=True))
        return after / before

    def document(self) -> Mapping[str, Any]:
        """JSON; radii in plane units."""
        return {
            "radii": list(_EDGES[1:-1]),
            "rings": [list(pair) for pair in self.rings],
            "clipped": list(self.clipped),
            "contrast_ratio": self.ratio,
            "glints": [list(pair) for pair in self.glints],
            "glint_ratio": self.glint_ratio,
        }


def highlight_profile(
    pictures: tuple[Picture, Picture],
    seen: TexelMask,
    measured: TexelMask,
    setup: FlashSetup,
    limit: float = 1.0,
) -> HighlightProfile | None:
    """Radial profiles and glints of both pictures; None if the mirror point is outside of them.

    Args:
        pictures: (H, W, 3) radiance of photograph and re-rendering on the plane's grid, clipped
            alike.
        seen: (H, W) bool, inside of the photograph.
        measured: (H, W) bool, `seen` and not clipped.
        setup: camera and flash.
        limit: radiance at which the pictures are clipped.
    """
    lights = [channel_mean(picture) for picture in pictures]
    distance, matte = from_mirror_point(setup, seen.shape), _matte(setup, seen.shape)
    rings = [
        seen & (distance >= inner) & (distance < outer)
        for inner, outer in zip(_EDGES, _EDGES[1:], strict=False)
    ]
    if not all(ring.any() for ring in rings):
        return None
    profiles = np.array(
        [[each[ring].sum() / matte[ring].sum() for each in lights] for ring in rings]
    )
    profiles = np.maximum(profiles, _DARKEST)  # a ring may be black
    profiles /= profiles[-1]
    reach = _reach(profiles[:, 0])
    region = seen & measured & (lights[1] < limit) & (distance < reach)
    glints = (
        [_octaves(each, region) for each in lights] if region.mean() >= LEAST_SHARE else [[], []]
    )
    return HighlightProfile(
        tuple((float(before), float(after)) for before, after in profiles),
        tuple(float((~measured[ring]).mean()) for ring in rings),
        tuple(zip(*glints, strict=True)),
    )


def _reach(profile: NDArray[np.float64]) -> float:
    """Radius within which the specular fraction is at least MIRRORED; 0 for none."""
    mirrored = 1.0 - 1.0 / np.maximum(profile[:-1], 1e-9) >= MIRRORED
    return _EDGES[len(mirrored) if mirrored.all() else int(mirrored.argmin())]


def _octaves(picture: Picture, region: TexelMask) -> list[float]:
    """Standard deviation of log radiance over a region, by octave, finest first."""
    log = filled(np.log(np.maximum(picture, _DARKEST)).astype(np.float32), region)
    blurs = [cv2.GaussianBlur(log, (0, 0), 2.0**octave) for octave in range(_OCTAVES + 1)]
    return [float((a - b)[region].std()) for a, b in zip(blurs, blurs[1:], strict=False)]


def from_mirror_point(setup: FlashSetup, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """(H, W) distance from the mirror point, plane units; upright if the setup is turned."""
    if setup.turned:
        landscape = from_mirror_point(replace(setup, turned=False), shape[::-1])
        return np.rot90(landscape, -1)
    (x, y), (height, width) = flash_mirror_point(setup), shape
    u, v = np.arange(width) + 0.5, np.arange(height)[:, None] + 0.5
    return np.hypot(2.0 * u / width - 1.0 - x, (height - 2.0 * v) / width - y)


def _matte(setup: FlashSetup, shape: tuple[int, ...]) -> Picture:
    """(H, W) radiance of a white matte plane: power (n.l) / pi."""
    height, width = shape
    points = plane_points(0, 0, width, height, (width, height), dtype=torch.float32)

    def some(rows: slice) -> Tensor:
        light = FlashLight.of(setup, points[:, rows])
        return light.power.mean(0) * light.to_light[2] / math.pi

    return torch.cat([some(rows) for rows in strips(height, cached_rows(width))]).numpy()
