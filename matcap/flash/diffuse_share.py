"""Diffuse share of radiance by ring around the highlight, from the colour contrast of texture.

The specular lobe of a dielectric has the colour of the flash: it adds light that albedo does not
modulate. In the dichromatic model [shafer1985], with irradiance E, albedo a, specular radiance s
and the flash's colour f, radiance is L = E f (a / pi + s) in each channel. Differences of two
channels of L / f have no specular part (the specular-free subspace of [mallick2005]); over the
local mean of L / f they are

    D L = share * D a / mean(a),    share = mean(a) / (mean(a) + pi s),

so in a ring around the mirror point the scatter of high-passed D L falls by the diffuse share.
Falloff, vignetting and the flash's cone leave it alone, and so do glints. Log ratios of channels,
which need no f, are moved by glints: on saturated materials they err by up to 4 times.

Neither the scatter of the texture nor its share in the outermost rings is known, so only ratios of
rings are a measurement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.files.color import srgb_slope
from matcap.photo.left_out import area_averaged
from matcap.photo.photo import ToneCurve

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]

ACROSS = 1024  # texels of the long side, of the grid on which it is measured
_SMOOTH, _TEXTURE = 1.5, 24.0  # texels; shortest and longest waves, standard deviations of blurs
RADII = (0.0, 0.08, 0.16, 0.25, 0.35, 0.5, 0.7, 1.1)  # of rings, plane units
_SECTORS = 12  # of a ring, by whose scatter its deviation is measured
_LEAST_TEXELS = 400.0  # of a ring
_MOST_UNSEEN = 0.7  # share of a ring that is clipped, dark or masked
_WHOLE = 0.98  # share of seen texels around a usable one
_DARKEST = 0.0025  # radiance of the darkest usable channel of a texel
# Standard deviation of a channel of a developed picture after _SMOOTH, in steps of its 8-bit codes.
_CODES = 0.3
_LEAST_DEVIATION = 0.2  # of a ring's log scatter, as shading of saturated colours adds to it
_LEAST_SCATTER = 0.012  # scatter by compression and shading, which is no texture's
_COLOUR_DEVIATION = 0.05  # of the flash's log colour, by which glints have one
_BY_NOISE = 0.5  # error of the noise's squared scatter over it
_BY_UNSEEN = 0.5  # deviation of a ring's log scatter over its unseen share
# Weight w of a tone curve's shoulder (photo/photo.py) and its deviation: 0 without a curve, 0.6
# of a phone's, 0.8 where a gain map undoes it. Contrast is lost in it as under a lobe.
_USUAL_SHOULDER, _SHOULDER_DEVIATION = 0.4, 0.3
_BY_EXCESS = 4.0  # deviation of a ring's log scatter over its excess over that of rings farther out
_MOST_DEVIATION = 1.0  # of all rings but one, at which nothing is measured
_FREE = 4.0  # deviation of the log scatter of the unveiled texture
_POINTS = 16  # texels at which a model's share is averaged over a ring


@dataclass(frozen=True)
class DiffuseRings:
    """Log scatter of n rings under one flash colour, to be compared with a model's share."""

    log_scatter: Doubles
    """(n,) of channel differences."""
    image: Doubles
    """(2, n, points) image coordinates of measured texels of each ring."""
    whitening: Doubles
    """(n, n) W with W^T W the precision of log scatter, whose common factor is free."""

    def residuals(self, share: Doubles) -> tuple[Doubles, Doubles]:
        """(n,) standardised residuals of the diffuse share (n,) of a model's radiance, and (n, n)
        their derivatives by it.
        """
        least = np.maximum(share, 1e-3)
        by = np.where(share < least, 0.0, -self.whitening / least)
        return self.whitening @ (self.log_scatter - np.log(least)), by


@dataclass(frozen=True)
class DiffuseShare:
    """Colour scatter of n rings, from the innermost."""

    moments: Doubles
    """(n, 3, 3) second moments of high-passed radiance by channel, over the local mean."""
    noise: Doubles
    """(n, 3) variance of the noise in them, by channel."""
    deviation: Doubles
    """(n,) standard deviation of the log scatter of a ring."""
    shoulder: Doubles
    """(n,) error of the log scatter if the tone curve's shoulder errs by its deviation."""
    image: Doubles
    """(2, n, points) image coordinates of measured texels of each ring."""

    def log_scatter(self, colour: Doubles) -> Doubles:
        """(n,) log scatter of channel differences; `colour` (3,) is the flash's."""
        white = np.diag(colour.mean() / colour)
        differences = white[::2] - white[1]
        moments = np.einsum("ic,ncd,id->n", differences, self.moments, differences)
        noise = self.noise @ np.square(differences).sum(0)
        # The noise is uncertain, so that no ring has none but it.
        return np.asarray(0.5 * np.log(np.maximum(moments - noise, 0.1 * moments + 1e-9)))

    def under(self, colour: Doubles) -> DiffuseRings:
        """The scatter under a flash of colour (3,).

        Errors of the tone curve's shoulder are common to all rings.
        """
        each = np.diag(np.square(self.deviation))
        common = np.outer(self.shoulder, self.shoulder) + _FREE**2
        whitening = np.linalg.inv(np.linalg.cholesky(each + common))
        return DiffuseRings(self.log_scatter(colour), self.image, whitening)


def undeveloped(picture: Floats, exponent: float) -> tuple[Floats, Floats]:
    """Light (H, W, 3) of a developed picture under the usual shoulder, and `tone` (H, W) of
    measure_diffuse_share.
    """
    curve = ToneCurve(exponent, _USUAL_SHOULDER)
    grey = picture.mean(-1).clip(0.0, 1.0)
    return curve.linear(picture), curve.slope_by_shoulder(grey)


def measure_diffuse_share(
    pixels: Floats,
    seen: NDArray[np.bool_],
    centre: tuple[float, float],
    *,
    developed: bool = True,
    noise: Floats | None = None,
    tone: Floats | None = None,
) -> DiffuseShare | None:
    """Measure the colour scatter of rings; None if fewer than two show any.

    Args:
        pixels: (H, W, 3) linear radiance, ACROSS texels across; 1 is where it clips.
        seen: (H, W) bool, texels of the material that are not clipped.
        centre: image coordinates of the highlight (the long side in [-1, 1], v up).
        developed: whether values are from 8-bit codes.
        noise: (H, W, 3) a sample of the sensor's noise, or None if unknown.
        tone: (H, W) d log slope of the tone curve / d shoulder, or None without a curve.
    """
    height, width = seen.shape
    unit = width / ACROSS
    smooth = blur(pixels, _SMOOTH * unit)
    whole = blur(seen.astype(np.float32), _SMOOTH * unit) > _WHOLE
    usable = whole & (smooth.min(-1) > _DARKEST)
    weight = usable.astype(np.float32)
    around = _wide_blur(weight, _TEXTURE * unit) + np.float32(1e-6)
    level = _wide_blur(smooth * weight[..., None], _TEXTURE * unit) / around[..., None]
    mean = np.maximum(level.mean(-1, keepdims=True), np.float32(1e-6))
    high = (smooth - level) / mean
    drawn = np.zeros_like(level) if noise is None else blur(noise, _SMOOTH * unit)
    if developed:
        drawn = _CODES / (255.0 * srgb_slope(level))
    variance = np.square(drawn / mean)
    u = (np.arange(width) + 0.5) * 2.0 / width - 1.0
    v = (height - 2.0 * (np.arange(height)[:, None] + 0.5)) / width
    radius = np.hypot(u - centre[0], v - centre[1])
    turn = np.arctan2(v - centre[1], u - centre[0]) / (2.0 * np.pi) % 1.0
    rings = []
    for inner, outer in pairwise(RADII):
        within = (radius >= inner) & (radius < outer)
        here = within & usable
        count = int(here.sum())
        unseen = 1.0 - count / max(int(within.sum()), 1)
        if count < _LEAST_TEXELS * unit**2 or unseen > _MOST_UNSEEN:
            continue
        texels = high[here].astype(np.float64)
        energy, error = _colour_energy(texels, turn[here])
        random = 2.0 * float(variance[here].sum(1).mean())
        tinted = _COLOUR_DEVIATION**2 * float(np.square(texels.mean(1)).mean())
        energy = max(energy - random, 0.1 * energy, 1e-9)
        others = math.sqrt((_LEAST_SCATTER**2 + tinted + _BY_NOISE * random) / energy)
        deviation = math.hypot(_LEAST_DEVIATION, others, error, _BY_UNSEEN * unseen)
        bent = 0.0 if tone is None else float(tone[here].mean())
        order = np.argsort(turn[here], kind="stable")[(np.arange(_POINTS) * count) // _POINTS]
        rows, columns = (each[order] for each in np.nonzero(here))
        rings.append(
            (
                texels.T @ texels / count,
                variance[here].mean(0),
                deviation,
                _SHOULDER_DEVIATION * bent,
                np.stack([u[columns], v[rows, 0]]),
            )
        )
    if len(rings) < 2:
        return None
    # No lobe adds scatter: what exceeds that of all rings farther out is of coloured glints.
    moments, floors, deviations, shoulder, image = (
        np.array(part, np.float64) for part in zip(*rings, strict=True)
    )
    measured = DiffuseShare(moments, floors, deviations, shoulder, np.moveaxis(image, 0, 1))
    log_scatter = measured.log_scatter(np.ones(3))
    farther = np.maximum.accumulate(log_scatter[::-1])[::-1][1:]
    excess = np.maximum(log_scatter[:-1] - farther, 0.0)
    deviations[:-1] += _BY_EXCESS * excess
    return measured if int((deviations < _MOST_DEVIATION).sum()) > 1 else None


def _colour_energy(texels: NDArray[np.float64], turn: NDArray[np.float64]) -> tuple[float, float]:
    """Mean square of channel differences over texels (n, 3), and the error of half its logarithm.

    Texels of a neighbourhood are correlated, so the error is that of sectors (by `turn`).
    """
    energy = np.square(texels[:, (0, 2)] - texels[:, 1:2]).sum(1)
    sector = np.minimum((turn * _SECTORS).astype(np.int64), _SECTORS - 1)
    number = np.bincount(sector, minlength=_SECTORS)
    many = number > 0.02 * len(texels)
    parts = np.bincount(sector, energy, _SECTORS)[many] / number[many]
    error = parts.std() / max(parts.mean(), 1e-12) / math.sqrt(max(len(parts) - 1, 1))
    return float(energy.mean()), 0.5 * float(error)


def blur(picture: Floats, deviation: float) -> Floats:
    """Gaussian blur, mirrored at the border: OpenCV's default excludes the outermost texel, a large
    share of a small picture.
    """
    blurred = cv2.GaussianBlur(picture, (0, 0), deviation, borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred, np.float32)


def _wide_blur(picture: Floats, deviation: float) -> Floats:
    """`blur` of a large deviation, on a grid of 4 x 4 pixels."""
    height, width = picture.shape[:2]
    small = area_averaged(picture, (max(1, width // 4), max(1, height // 4)))
    return np.asarray(cv2.resize(blur(small, deviation / 4.0), (width, height)), np.float32)
