"""Bundle adjustment of all cameras and their common lens over all feature matches.

Matches are between the first photograph, which defines the plane frame up to its tilt, and every
other one. Levenberg-Marquardt on the Huber cost of reprojection errors; the residuals of a
photograph depend on its six pose parameters and the common ones only (sparse Jacobian).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.flash.geometry import FlashSetup
from matcap.flash.registration.camera import Lens, PosedCamera

Doubles = NDArray[np.float64]


_HUBER = 1.0  # threshold of the Huber loss, pixels
# Largest effective number of a photograph's matches, as the parallax of relief is correlated
# between neighbours.
_COUNTED = 40.0
_STEPS = 30  # most iterations of Levenberg-Marquardt
# Prior standard deviations: of log d, if EXIF gives the field of view and if not; of the first
# camera's tilt, radians; of a feature's height, plane units; of the lens distortion, k1 and k2.
_KNOWN_FOCAL, _ASSUMED_FOCAL, _TILT = 0.01, 0.1, 0.15
_RELIEF, BENT = 0.01, (0.03, 0.01)


@dataclass(frozen=True)
class Pair:
    """Feature matches of a photograph with the first."""

    first: Doubles
    """(2, n) image coordinates in the first."""
    second: Doubles
    """(2, n) image coordinates in the photograph."""
    pixel: float
    """Size of the photograph's pixel in image coordinates."""
    focal: float = 1.0
    """Focal length of the photograph over the first's, by metadata or assumed."""


class _Common(NamedTuple):
    """Parameters of all photographs: camera distance, lens, and the first camera's tilt."""

    log_distance: float  # over the setup's
    k1: float
    k2: float
    tilt_x: float
    tilt_y: float

    def first_camera(self, setup: FlashSetup) -> PosedCamera:
        """The first photograph's."""
        return PosedCamera.of(self.adjusted(setup), (self.k1, self.k2))

    def adjusted(self, setup: FlashSetup) -> FlashSetup:
        """The setup with the estimated field of view and tilt."""
        distance = setup.distance * math.exp(self.log_distance)
        fov = 2.0 * math.degrees(math.atan(1.0 / distance))
        return replace(setup, fov=fov, tilt=(self.tilt_x, self.tilt_y))

    def camera(self, setup: FlashSetup, pose: Doubles, focal: float) -> PosedCamera:
        """Another photograph's, by its pose (6,) and its focal length over the first's."""
        turn = np.asarray(cv2.Rodrigues(pose[_TURN])[0], np.float64)
        distance = setup.distance * math.exp(self.log_distance)
        return PosedCamera(turn, pose[_PLACE], Lens(distance * focal, (self.k1, self.k2)))


_COMMON = len(_Common._fields)
_OWN, _TURN, _PLACE = 6, slice(0, 3), slice(3, 6)  # a pose: rotation vector and position


@dataclass(frozen=True)
class Adjusted:
    """Result of the bundle adjustment."""

    first: FlashSetup
    """Setup of the first photograph with the estimated tilt and field of view."""
    cameras: tuple[PosedCamera, ...]
    """Cameras of all photographs, the first one's first."""
    off: tuple[float, ...]
    """(photographs - 1,) median reprojection error of each, pixels."""


def adjust(
    setup: FlashSetup,
    pairs: Sequence[Pair],
    *,
    known: bool,
    relief: float = _RELIEF,
    bent: tuple[float, float] = BENT,
) -> Adjusted:
    """Estimate the cameras of photographs from their matches with the first.

    Args:
        setup: of the first, from its coarse fit.
        pairs: matches of every other photograph.
        known: whether the field of view is known from EXIF.
        relief: prior standard deviation of a feature's height, plane units.
        bent: prior standard deviations of the lens distortion, k1 and k2.
    """
    focal = _KNOWN_FOCAL if known else _ASSUMED_FOCAL
    deviation = np.array([focal, *bent, _TILT, _TILT])
    begun = _Common(0.0, 0.0, 0.0, *setup.tilt)
    prior = common = np.array(begun)
    own = [_first_guess(begun.first_camera(setup), pair) for pair in pairs]
    damping, cost = 1e-3, math.inf
    for _ in range(_STEPS):
        system = _System(setup, pairs, common, own, relief)
        now = system.cost + float(np.square((common - prior) / deviation).sum()) / 2.0
        step = system.step((prior - common) / deviation**2, deviation**-2, damping)
        moved = common + step[:_COMMON]
        theirs = [each + part for each, part in zip(own, _parts(step), strict=True)]
        after = _cost(setup, pairs, moved, theirs, relief)
        after += float(np.square((moved - prior) / deviation).sum()) / 2.0
        if after < now:
            common, own, damping = moved, theirs, max(damping / 8.0, 1e-9)
            if cost - after < 1e-7 * after:
                break
            cost = after
        else:
            damping *= 8.0
            if damping > 1e6:
                break
    fitted = _Common(*common.tolist())
    cameras = [fitted.first_camera(setup)]
    cameras += [
        fitted.camera(setup, each, pair.focal) for each, pair in zip(own, pairs, strict=True)
    ]
    off = tuple(
        float(np.median(np.hypot(*_residuals(setup, pair, common, each, relief))))
        for pair, each in zip(pairs, own, strict=True)
    )
    return Adjusted(fitted.adjusted(setup), tuple(cameras), off)


def _residuals(
    setup: FlashSetup, pair: Pair, common: Doubles, own: Doubles, relief: float
) -> Doubles:
    """(2, n) reprojection errors of matches, pixels, less the part explained by relief."""
    every = _Common(*common.tolist())
    first, camera = every.first_camera(setup), every.camera(setup, own, pair.focal)
    return less_relief(*reprojection(first, camera, pair, relief))


def reprojection(
    first: PosedCamera, camera: PosedCamera, pair: Pair, height: float
) -> tuple[Doubles, Doubles]:
    """(2, n) reprojection errors in pixels, and the parallax of a height above the plane."""
    points = first.on_plane(pair.first)
    seen = camera.sees(points)
    # Raised along the first camera's rays, so that it sees the features at the same coordinates.
    raised = points + height * (first.place[:, None] - points) / first.place[2]
    parallax = (camera.sees(raised) - seen) / pair.pixel
    return (seen - pair.second) / pair.pixel, parallax


def less_relief(residual: Doubles, parallax: Doubles) -> Doubles:
    """Residuals (2, n) with heights eliminated, which have unit variance in units of `parallax`.

    The squared length of the result is the minimum over x of |residual - x parallax|^2 + x^2.
    """
    squared = np.square(parallax).sum(0)
    along = (1.0 - 1.0 / np.sqrt(1.0 + squared)) / np.maximum(squared, 1e-12)
    left = residual - along * (residual * parallax).sum(0) * parallax
    return np.nan_to_num(left, nan=1e3)


def _huber(residuals: Doubles) -> tuple[float, Doubles]:
    """Huber cost of residuals (2, n), pixels, and the weight of each."""
    size, threshold = np.hypot(*residuals), _HUBER
    each = min(1.0, _COUNTED / max(1, len(size)))
    cost = np.where(size < threshold, size**2 / 2.0, threshold * (size - threshold / 2.0))
    return each * float(cost.sum()), each * threshold / np.maximum(size, threshold)


def _cost(
    setup: FlashSetup,
    pairs: Sequence[Pair],
    common: Doubles,
    own: Sequence[Doubles],
    relief: float,
) -> float:
    """Huber cost of all photographs' reprojection errors."""
    return sum(
        _huber(_residuals(setup, pair, common, each, relief))[0]
        for pair, each in zip(pairs, own, strict=True)
    )


class _System:
    """Normal equations of all photographs at the current parameters."""

    def __init__(
        self,
        setup: FlashSetup,
        pairs: Sequence[Pair],
        common: Doubles,
        own: Sequence[Doubles],
        relief: float,
    ) -> None:
        size = _COMMON + _OWN * len(pairs)
        self.normal, self.gradient, self.cost = np.zeros((size, size)), np.zeros(size), 0.0
        for number, (pair, each) in enumerate(zip(pairs, own, strict=True)):
            here = _residuals(setup, pair, common, each, relief)
            cost, weight = _huber(here)
            whole = np.concatenate([common, each])
            columns = []
            for index in range(len(whole)):
                moved = whole.copy()
                moved[index] += 1e-6
                there = _residuals(setup, pair, moved[:_COMMON], moved[_COMMON:], relief)
                columns.append(((there - here) / 1e-6).ravel())
            jacobian = np.stack(columns, 1)
            weights = np.tile(weight, 2)
            block = (jacobian * weights[:, None]).T @ jacobian
            gradient = jacobian.T @ (weights * here.ravel())
            first = _COMMON + _OWN * number
            places = np.r_[0:_COMMON, first : first + _OWN]
            self.normal[np.ix_(places, places)] += block
            self.gradient[places] += gradient
            self.cost += cost

    def step(self, pull: Doubles, precision: Doubles, damping: float) -> Doubles:
        """Damped step of all parameters, with a Gaussian prior of the common ones."""
        normal, gradient = self.normal.copy(), -self.gradient
        normal[range(_COMMON), range(_COMMON)] += precision
        gradient[:_COMMON] += pull
        normal += damping * np.diag(normal.diagonal()) + 1e-12 * np.eye(len(normal))
        return np.asarray(np.linalg.solve(normal, gradient))


def _parts(step: Doubles) -> list[Doubles]:
    """Each photograph's own part (6,) of a step."""
    return list(step[_COMMON:].reshape(-1, _OWN))


def _first_guess(first: PosedCamera, pair: Pair) -> Doubles:
    """(6,) initial pose of a camera from its homography to the first [collins2014]."""
    points = first.on_plane(pair.first)
    focal = first.lens.focal * pair.focal
    # OpenCV's camera looks along +z with y downwards.
    seen = np.stack([pair.second[0], -pair.second[1]]).T.copy()
    matrix = np.diag([focal, focal, 1.0])
    flip = np.diag([1.0, -1.0, -1.0])
    _, turns, shifts, errors = cv2.solvePnPGeneric(
        points.T.copy(), seen, matrix, None, flags=cv2.SOLVEPNP_IPPE
    )
    best = int(np.argmin(np.ravel(errors)))
    turn = cv2.Rodrigues(turns[best])[0]
    place = -turn.T @ shifts[best].ravel()
    vector = np.asarray(cv2.Rodrigues(flip @ turn)[0], np.float64).ravel()
    return np.concatenate([vector, place])
