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
    BENT,
    RELIEF,
    STEP,
    TILT,
    Adjusted,
    MatchedPoints,
    Pair,
    less_relief,
)
from matcap.capture.registration.camera import Doubles, Lens, PosedCamera, grid_points

DOUBTED = 0.002  # standard deviation of a position, over its distance, above which it is reported

# Prior standard deviations and noise model; docs/notes/several.md.
_ALIKE = 3.0  # standard deviation of the features' common apparent depth over that of single ones
# Tangent of the light's angle at which the displacement by shading is half the linear one.
_SATURATED = 0.5
_ALONE = 0.25  # share of features that are independent (do not overlap others)
_FOCAL = 0.005  # prior standard deviation of the log focal length

_OWN = 6  # parameters of each photograph alone: rotation and position


@dataclass(frozen=True)
class Doubts:
    """Standard deviations of camera positions and registration, (photographs - 1,) each."""

    positions: Doubles
    """Each camera's position relative to the first, over its distance."""
    misregistration: Doubles
    """Each photograph's registration to the first, plane units; much less than `positions`, as
    errors of position and rotation nearly cancel on the plane."""


def doubts(fit: Adjusted, pairs: Sequence[Pair]) -> Doubts:
    """Standard deviations of camera positions and of the photographs' registration.

    Args:
        fit: cameras after bundle adjustment.
        pairs: the matches they were fitted to.
    """
    first, *others = fit.cameras
    known = list(zip(others, _covariances(fit, pairs), strict=True))
    return Doubts(
        np.array([_off(first, *each) for each in known]),
        np.array([_misregistration(first, *each) for each in known]),
    )


def _covariances(fit: Adjusted, pairs: Sequence[Pair]) -> list[Doubles]:
    """(10, 10) of each other photograph: of a `_changed`'s change, error by shading included."""
    first, *others = fit.cameras
    deviation = np.array([_FOCAL, BENT[0], TILT, TILT])  # of the parameters that all share
    normal = np.diag(np.r_[deviation**-2, np.zeros(_OWN * len(pairs))])
    shared, own = np.split(np.arange(len(normal)), [len(deviation)])
    blocks = [np.r_[shared, each] for each in own.reshape(len(pairs), _OWN)]
    pulled, depths = np.zeros(len(normal)), []
    for camera, pair, block in zip(others, pairs, blocks, strict=True):
        residual, parallax = MatchedPoints.of(first, pair, RELIEF).reprojected(camera, pair)
        noise, depth = _scatter(residual, parallax)
        depths.append(depth)
        jacobian, shading = _linear(first, camera, pair)
        # Matches beyond four standard deviations are outliers, with weight 0.
        kept = np.tile(np.hypot(*less_relief(residual, parallax)) < 4.0 * noise, 2)
        weight = _ALONE * kept / noise**2
        normal[np.ix_(block, block)] += (jacobian.T * weight) @ jacobian
        pulled[block] += (jacobian.T * weight) @ shading
    covariance = np.asarray(np.linalg.inv(normal + 1e-9 * np.eye(len(normal))), np.float64)
    depth = float(np.median(depths)) if depths else 0.0
    moved = _ALIKE * depth * (covariance @ pulled)
    covariance += np.outer(moved, moved)
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
    """(2n, 10) d residual / d parameter of a photograph, and (2n,) d residual / d common depth."""

    def off(change: Doubles, depth: float = 0.0) -> Doubles:
        one, other = _changed(first, camera, change)
        residual, parallax = MatchedPoints.of(one, pair, RELIEF).reprojected(other, pair)
        if depth:
            residual = residual + depth * shaded
        return less_relief(residual, parallax).ravel()

    shaded = _shaded(first, camera, pair)
    return _jacobian(off, 10), (off(np.zeros(10), STEP) - off(np.zeros(10))) / STEP


def _shaded(first: PosedCamera, camera: PosedCamera, pair: Pair) -> Doubles:
    """(2, n) displacement by shading between two flashes, pixels per plane unit of depth."""
    points = first.on_plane(pair.first)

    def moved(place: Doubles) -> Doubles:
        towards = (place[:2, None] - points[:2]) / place[2]
        return np.asarray(towards / (1.0 + np.square(towards).sum(0) / _SATURATED**2))

    shift = np.concatenate([moved(camera.place) - moved(first.place), np.zeros_like(points[2:])])
    return (camera.sees(points + STEP * shift) - camera.sees(points)) / (STEP * pair.pixel)


def _changed(
    first: PosedCamera, camera: PosedCamera, change: Doubles
) -> tuple[PosedCamera, PosedCamera]:
    """Change the first camera and another.

    `change` (10,) is of log focal length, k1, the first one's rotation about x and y, and the
    other's rotation (3,) and position (3,).
    """
    (focal,), (bent,), (x, y), turn, place = np.split(change, [1, 2, 4, 7])

    def lens(old: Lens) -> Lens:
        return Lens(old.focal * math.exp(focal), (old.bent[0] + bent, old.bent[1]))

    leant = _turn(np.array([x, y, 0.0]))
    one = PosedCamera(first.turn @ leant.T, leant @ first.place, lens(first.lens))
    return one, PosedCamera(_turn(turn) @ camera.turn, camera.place + place, lens(camera.lens))


def _turn(vector: Doubles) -> Doubles:
    """(3, 3) rotation by a small vector, to first order and orthogonal to second."""
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + cross + 0.5 * cross @ cross)


def _off(first: PosedCamera, camera: PosedCamera, covariance: Doubles) -> float:
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

    def seen(change: Doubles) -> Doubles:
        one, other = _changed(first, camera, change)
        return camera.on_plane(other.sees(one.on_plane(image)))[:2].ravel()

    return math.sqrt(2.0 * float(_variance(seen, covariance).mean()))


def _variance(f: Callable[[Doubles], Doubles], covariance: Doubles) -> Doubles:
    """(n,) variances of f(change) (n,), by linear propagation of the change's covariance."""
    jacobian = _jacobian(f, len(covariance))
    return np.asarray(np.einsum("ni,ij,nj->n", jacobian, covariance, jacobian))


def _jacobian(f: Callable[[Doubles], Doubles], size: int) -> Doubles:
    """(n, size) d f(change) / d change at 0."""
    here = f(np.zeros(size))
    return np.stack([(f(STEP * unit) - here) / STEP for unit in np.eye(size)], 1)
