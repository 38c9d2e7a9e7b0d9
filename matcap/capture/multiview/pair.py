"""One photograph with flash and one without: registered on albedo, relief by their ratio.

Features of shading lie on the side of a bump that faces the light, so those of a flash and of
ambient light are displaced against each other, by several texels towards the border. Albedo is not.
So the ambient photograph is registered to the log albedo that the network predicts from the flash
photograph, by the homography of greatest correlation (ECC: [evangelidis2008]), which determines the
camera.

Albedo cancels in the ratio of the two photographs. To first order its logarithm is (g - l) . s with
slope s, where g and l are d log L / d slope under flash and ambient light. So slope energies are
measured by octave and direction in the ratio as they are in one photograph
(exemplar/relief_spectrum.py), with noise and misregistration in place of albedo.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import ALBEDO
from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.octaves import BANDS, local_mean, smoothed, split
from matcap.capture.exemplar.relief_spectrum import (
    RESPONSE_AROUND,
    equalise,
    measure_relief_spectrum,
)
from matcap.capture.multiview.texels import OTHER_SLOPES, SLOPES, derivatives
from matcap.capture.multiview.views import (
    GRADIENT_DEVIATION,
    UNIFORM_SKY,
    Resampled,
    SharedLight,
    Views,
    light_at,
)
from matcap.capture.registration.camera import Doubles, camera_of, grid_points, transformed
from matcap.capture.registration.keypoints import log_on_grid
from matcap.flash.geometry import points_of

Floats = NDArray[np.float32]

# Registration of an ambient photograph, and relief by it; docs/notes/several.md.

# Longest and shortest wavelength of each compared octave, texels.
_BANDS = ((128.0, 64.0), *BANDS[:3])
_AROUND = 24.0  # standard deviation of the local contrast normalisation, texels
_SHRUNK = (4.0, 2.0, 1.0)  # subsampling of the grids of ECC, coarse to fine, texels
_STEPS = 60  # most iterations of ECC on each grid
_LEAST = 0.2  # least correlation; below it the registration by features is kept
_THINNED = 16  # subsampling of points for the camera and of texels for the regression, texels
_PIXEL = 2e-4  # standard deviation of the resulting registration, plane units
_WINDOWS = 40.0  # the long side over the standard deviation of local energies
_CERTAIN = 1.0  # texels: a smaller registration error by features is kept
_FINEST = 4.0  # wavelength, texels, below which bands keep their predicted energy
# The long side over the standard deviation of the low-pass that is subtracted from the ratio.
_SLOW = 16.0


def on_albedo(views: Views, prediction: MapSet) -> Views:
    """Refit the camera of the photograph without flash on predicted albedo.

    Args:
        views: registered by features.
        prediction: the network's maps of the first photograph, on the plane of its camera.

    Returns:
        `views`, unchanged if none is without flash, or its correlation is too small.
    """
    ambient, (across, down) = views[-1], prediction.size
    if ambient.flash:
        return views
    if ambient.misregistration < _CERTAIN * prediction.texel_size:
        return (*views[:-1], replace(ambient, misregistration=_PIXEL))
    albedo = prediction.diffuse.clamp_min(1e-3).log().mean(0).numpy()
    wide = min(ambient.photo.pixels.shape[1], 2 * across)
    size, linear = prediction.size, cv2.INTER_LINEAR
    photograph, _ = log_on_grid(ambient.photo, ambient.camera, size, wide, 1e-4, linear)
    homography = _correlated(_normalised(albedo), _normalised(photograph))
    if homography is None:
        return views
    to_plane = np.diag([2.0 / across, -2.0 / across, 1.0])
    to_plane[:2, 2] = (1.0 - across) / across, (down - 1.0) / across
    thin = slice(None, None, _THINNED)
    points = grid_points(across, down)[:, thin, thin].reshape(3, -1)
    moved = transformed(to_plane @ homography @ np.linalg.inv(to_plane), points[:2])
    image = ambient.camera.sees(np.concatenate([moved, points[2:]]))
    camera = camera_of(points, image, ambient.camera.lens, refined=True)
    return (*views[:-1], replace(ambient, camera=camera, misregistration=_PIXEL))


def _normalised(log: Floats) -> Floats:
    """(h, w) octaves of _BANDS of a picture over their local contrast."""
    fine = np.sum(split(np.asarray(log, np.float32), _BANDS)[:-1], axis=0)
    around = cv2.GaussianBlur(fine * fine, (0, 0), _AROUND)
    return np.asarray(fine / np.sqrt(around + 1e-6), np.float32)


def _correlated(fixed: Floats, moving: Floats) -> Floats | None:
    """(3, 3) homography from texels of `fixed` to those of `moving` by ECC; None if it fails."""
    homography, correlation = np.eye(3, dtype=np.float32), 0.0
    for factor in _SHRUNK:
        scale = np.diag([1.0 / factor, 1.0 / factor, 1.0]).astype(np.float32)
        small = [
            cv2.resize(each, None, fx=1.0 / factor, fy=1.0 / factor, interpolation=cv2.INTER_AREA)
            for each in (fixed, moving)
        ]
        start = np.asarray(scale @ homography @ np.linalg.inv(scale), np.float32)
        stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _STEPS, 1e-6)
        try:
            correlation, fitted = cv2.findTransformECC(
                small[0], small[1], start, cv2.MOTION_HOMOGRAPHY, stop
            )
        except cv2.error:  # nothing in common
            return None
        homography = np.asarray(np.linalg.inv(scale) @ fitted @ scale, np.float32)
    return homography if correlation > _LEAST else None


@dataclass(frozen=True)
class Ratio:
    """Log ratio of a flash photograph's radiance to an ambient one's, in which albedo cancels."""

    log: Floats
    """(H, W) the log ratio, high-passed."""
    sensitivity: Floats
    """(2, H, W) its derivative by slope along x and y (upwards), smoothed."""
    matte: Floats
    """(H, W) diffuse share of the flash photograph's radiance."""
    use: Floats
    """(H, W) 1 where both are valid, else 0."""

    @staticmethod
    def of(views: Resampled, parameters: Tensor, light: SharedLight) -> Ratio:
        """Ratio of the first to the last photograph, linearised about a flat surface.

        Args:
            views: the first with flash, the last without.
            parameters: (PARAMETERS, H, W) current; F0, roughness and mean albedo are used.
        """
        first, last, size = views[0], views[-1], parameters.shape[1:]
        points = points_of(size, extent=first.extent)
        flat = parameters.clone()
        flat[ALBEDO] = flat[ALBEDO].mean((1, 2), keepdim=True)
        flat[SLOPES] = 0.0
        lights = [light_at(0, first, light, points), light_at(len(views) - 1, last, light, points)]
        (flash, flash_share, by_flash), (ambient, ambient_share, by_ambient) = (
            (log, share.unflatten(-1, size), by_others[OTHER_SLOPES].unflatten(-1, size))
            for log, share, by_others in derivatives(flat, lights)
        )
        share = flash_share / ambient_share.clamp_min(1e-3)

        def ratio(flash: Tensor, ambient: Tensor) -> Floats:
            return np.asarray((flash - share * ambient).mean(0).numpy(), np.float32)

        both_slopes = zip(by_flash, by_ambient, strict=True)
        sensitivity = np.stack([smoothed(ratio(*both), RESPONSE_AROUND) for both in both_slopes])
        use = (first.seen & last.seen).all(0).numpy().astype(np.float32)
        log = ratio(first.log - flash, last.log - ambient)
        log = (log - local_mean(log, use, max(use.shape) / _SLOW)) * use
        return Ratio(log, sensitivity, flash_share.mean(0).numpy(), use)


def with_ambient_gradient(views: Resampled, parameters: Tensor, light: SharedLight) -> SharedLight:
    """Estimate the gradient of ambient light (SharedLight.ambient) from the contrast of the ratio.

    Isotropic relief of slope energy S has the energy A + S |g - l|^2 / 2 in the ratio, with its
    minimum at g = l. So local energies are fitted by weighted least squares as quadratic in g.
    Returns `light` unchanged if no photograph is without flash. Arguments are those of Ratio.of.
    """
    if views[-1].flash:
        return light
    light = replace(light, ambient=torch.tensor(UNIFORM_SKY))
    ratio = Ratio.of(views, parameters, light)
    around = max(ratio.use.shape) / _WINDOWS
    energy = local_mean(np.square(np.sum(split(ratio.log)[:4], axis=0)), ratio.use, around)
    x, y = (smoothed(each, around) for each in ratio.sensitivity)
    seen = smoothed(ratio.use, around) > 0.8
    seen_share = float(seen.mean())
    seen[np.indices(seen.shape).sum(0) % _THINNED > 0] = False
    if seen.sum() < 100:
        return light
    terms = np.stack([np.ones_like(x), x, y, x * x + y * y])[:, seen].astype(np.float64)
    measured = energy[seen].astype(np.float64)
    weight: Doubles = np.ones_like(measured)
    for _ in range(8):
        normal = (terms * weight) @ terms.T
        damped = normal + 1e-9 * np.trace(normal) * np.eye(4)
        fitted = np.linalg.solve(damped, terms @ (weight * measured))
        weight = 1.0 / np.square(np.maximum(fitted @ terms, 0.2 * measured.mean()))
    linear, squared = slice(1, 3), 3  # of the terms
    relief = max(float(fitted[squared]), 1e-9)
    # Samples for each independent one, as local energies overlap.
    overlap = weight.size * 4.0 * np.pi * around**2 / seen_share / ratio.use.size
    scatter = float((weight * np.square(fitted @ terms - measured)).mean()) * overlap
    variance = scatter * np.linalg.inv(normal).diagonal()
    slope = fitted[linear] / (2.0 * relief)
    slope_variance = (variance[linear] + np.square(2.0 * slope) * variance[squared]) / (
        2.0 * relief
    ) ** 2
    slope = slope * GRADIENT_DEVIATION**2 / (GRADIENT_DEVIATION**2 + slope_variance)
    slope = np.clip(slope, -2.0 * GRADIENT_DEVIATION, 2.0 * GRADIENT_DEVIATION)
    return replace(light, ambient=torch.tensor([*slope.tolist(), UNIFORM_SKY[2]]))


def scaled_by_ratio(
    height: Tensor, views: Resampled, parameters: Tensor, light: SharedLight
) -> Tensor:
    """Scale a height's slope energies by octave and direction to those measured in the ratio.

    Returns the height unchanged, unless there is one photograph with flash and one without.

    Args:
        height: (1, H, W), plane units.
        views, parameters, light: as of Ratio.of.
    """
    if len(views) != 2 or views[1].flash:
        return height
    texel = views[0].extent.texel(height.shape[-1])
    texels = np.asarray(height[0].numpy() / texel, np.float32)
    ratio = Ratio.of(views, parameters, light)
    spectrum = measure_relief_spectrum(ratio.log, ratio.sensitivity, ratio.use, matte=ratio.matte)
    # A registration error below a texel looks like fine relief.
    uncertain = np.array([[shortest < _FINEST] for _, shortest in BANDS])
    spectrum = spectrum and replace(spectrum, error=np.where(uncertain, np.inf, spectrum.error))
    even = equalise(texels, spectrum, ratio.sensitivity)
    return texel * torch.from_numpy(split(texels)[-1] + even)[None]
