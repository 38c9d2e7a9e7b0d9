"""Covariance of the bundle-adjusted cameras.

Random errors of features average out; those of shading do not. The lit side of a bump follows the
flash, like a point at another depth (a highlight like the bump's centre of curvature), by the same
depth for all bumps of a material. This common depth cannot be estimated from the matches, as a
plane at that depth gives the same ones; its standard deviation is taken from the apparent depths of
single features. It is a consider parameter: in the covariance, but not estimated [schmidt1966].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from matcap.capture.registration.adjust import (
    DISTORTION,
    RELIEF,
    STEP,
    TILT,
    Adjusted,
    Pair,
    less_relief,
    parameter_blocks,
    reprojected,
)
from matcap.capture.registration.camera import Doubles, Lens, PosedCamera, grid_points
from matcap.flash.least_squares import jacobian

# Prior standard deviations and noise model; docs/notes/several.md.
# Standard deviation of the features' common apparent depth over that of single ones.
_COMMON_DEPTH = 3.0
# Tangent of the light's angle at which the displacement by shading is half the linear one.
_SATURATED = 0.5
_INDEPENDENT = 0.25  # share of features that are independent (do not overlap others)
_FOCAL = 0.005  # prior standard deviation of the log focal length

# Changes (10,) of two cameras: log focal length, k1, and the first camera's rotation about x and y,
# which all photographs share; the other camera's rotation and position.
_SHARED, _CHANGES = 4, 10


@dataclass(frozen=True)
class CameraDeviations:
    """Standard deviations of camera positions and registration, (photographs - 1,) each."""

    positions: Doubles
    """Each camera's position relative to the first, over its distance."""
    misregistration: Doubles
    """Each photograph's registration to the first, plane units; much less than `positions`, as
    errors of position and rotation nearly cancel on the plane."""


def camera_deviations(fit: Adjusted, pairs: Sequence[Pair]) -> CameraDeviations:
    """Standard deviations of camera positions and of the photographs' registration.

    Args:
        fit: cameras after bundle adjustment.
        pairs: the matches they were fitted to.
    """
    first, *others = fit.cameras
    each = list(zip(others, _covariances(fit, pairs), strict=True))
    return CameraDeviations(
        np.array([_position_deviation(first, *one) for one in each]),
        np.array([_misregistration(first, *one) for one in each]),
    )


def _covariances(fit: Adjusted, pairs: Sequence[Pair]) -> list[Doubles]:
    """(10, 10) covariance of the changes of each other photograph, error by shading included."""
    first, *others = fit.cameras
    deviation = np.array([_FOCAL, DISTORTION[0], TILT, TILT])
    blocks = parameter_blocks(_SHARED, len(pairs))
    normal = np.diag(np.r_[deviation**-2, np.zeros(6 * len(pairs))])
    gradient, depths = np.zeros(len(normal)), []
    for camera, pair, block in zip(others, pairs, blocks, strict=True):
        residual, parallax = reprojected(first, camera, pair, RELIEF)
        noise, depth = _scatter(residual, parallax)
        depths.append(depth)
        by_change, by_depth = _linear(first, camera, pair)
        # Matches beyond four standard deviations are outliers, with weight 0.
        kept = np.tile(np.hypot(*less_relief(residual, parallax)) < 4.0 * noise, 2)
        weighted = by_change.T * (_INDEPENDENT * kept / noise**2)
        normal[np.ix_(block, block)] += weighted @ by_change
        gradient[block] += weighted @ by_depth
    covariance = np.asarray(np.linalg.inv(normal + 1e-9 * np.eye(len(normal))), np.float64)
    depth = float(np.median(depths)) if depths else 0.0
    by_shading = _COMMON_DEPTH * depth * (covariance @ gradient)
    covariance += np.outer(by_shading, by_shading)
    return [covariance[np.ix_(block, block)] for block in blocks]


def _scatter(residual: Doubles, parallax: Doubles) -> tuple[float, float]:
    """Standard deviation of matches, pixels, and of their apparent depth, plane units."""
    length = np.maximum(np.hypot(*parallax), 1e-9)
    along = (residual * parallax).sum(0) / length
    across = (residual[0] * parallax[1] - residual[1] * parallax[0]) / length
    noise = max(1.48 * float(np.nanmedian(np.abs(across))), 0.05)
    pixels = float(np.nanmedian(length)) / RELIEF
    return noise, 1.48 * float(np.nanmedian(np.abs(along))) / pixels


def _linear(first: PosedCamera, camera: PosedCamera, pair: Pair) -> tuple[Doubles, Doubles]:
    """(2n, 10) d residual / d change of a photograph, and (2n,) d residual / d common depth."""
    shading = _shading(first, camera, pair)

    def residual(change: Doubles) -> Doubles:
        errors, parallax = reprojected(*_changed(first, camera, change[:-1]), pair, RELIEF)
        return less_relief(errors + change[-1] * shading, parallax)

    derivative = jacobian(residual, np.zeros(_CHANGES + 1), STEP)
    by_change, by_depth = np.split(derivative, [_CHANGES], 1)
    return by_change, by_depth.ravel()


def _shading(first: PosedCamera, camera: PosedCamera, pair: Pair) -> Doubles:
    """(2, n) displacement by shading between two flashes, pixels per plane unit of depth."""
    points = first.on_plane(pair.first)

    def displacement(flash: Doubles) -> Doubles:
        tangent = (flash[:2, None] - points[:2]) / flash[2]
        return np.asarray(tangent / (1.0 + np.square(tangent).sum(0) / _SATURATED**2))

    across = displacement(camera.place) - displacement(first.place)
    shift = np.concatenate([across, np.zeros_like(points[2:])])
    return (camera.sees(points + STEP * shift) - camera.sees(points)) / (STEP * pair.pixel)


def _changed(
    first: PosedCamera, camera: PosedCamera, change: Doubles
) -> tuple[PosedCamera, PosedCamera]:
    """The first camera and another after a change (10,)."""
    (log_focal, k1), first_turn, turn, place = np.split(change, (2, _SHARED, 7))

    def lens(old: Lens) -> Lens:
        distortion = old.distortion[0] + k1, old.distortion[1]
        return Lens(old.focal * math.exp(log_focal), distortion)

    rotation = _rotation(np.r_[first_turn, 0.0])
    one = PosedCamera(first.turn @ rotation.T, rotation @ first.place, lens(first.lens))
    turned = _rotation(turn) @ camera.turn
    return one, PosedCamera(turned, camera.place + place, lens(camera.lens))


def _rotation(vector: Doubles) -> Doubles:
    """(3, 3) rotation by a small vector, to first order and orthogonal to second."""
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + cross + 0.5 * cross @ cross)


def _position_deviation(first: PosedCamera, camera: PosedCamera, covariance: Doubles) -> float:
    """Standard deviation of a camera's position in the first one's frame, over its distance."""

    def between(change: Doubles) -> Doubles:
        one, other = _changed(first, camera, change)
        return np.asarray(one.turn @ (other.place - one.place))

    variance = _variance(between, covariance)
    return math.sqrt(float(variance.sum())) / float(np.linalg.norm(camera.place))


def _misregistration(first: PosedCamera, camera: PosedCamera, covariance: Doubles) -> float:
    """Registration error of a photograph to the first, plane units, where both show the plane."""
    points = grid_points(16, 12).reshape(3, -1)
    both = (np.abs(camera.sees(points)) < 1.0).all(0)
    image = first.sees(points[:, both] if both.any() else points)

    def place(change: Doubles) -> Doubles:
        one, other = _changed(first, camera, change)
        return camera.on_plane(other.sees(one.on_plane(image)))[:2]

    return math.sqrt(2.0 * float(_variance(place, covariance).mean()))


def _variance(f: Callable[[Doubles], Doubles], covariance: Doubles) -> Doubles:
    """(n,) variances of f(change), flattened, by linear propagation of the change's covariance."""
    derivative = jacobian(f, np.zeros(_CHANGES), STEP)
    return np.asarray(np.einsum("ni,ij,nj->n", derivative, covariance, derivative))
