"""Bundle adjustment of all cameras and their common lens over all feature matches.

Matches are between the first photograph, which defines the plane frame up to its tilt, and every
other one. The Huber cost of reprojection errors is minimised (flash/least_squares.py); the
residuals of a photograph depend on its six pose parameters and the common ones only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.capture.registration.camera import Doubles, Lens, PosedCamera, camera_of
from matcap.flash.geometry import FlashSetup
from matcap.flash.least_squares import minimised

_HUBER = 1.0  # threshold of the Huber loss, pixels
# Largest effective number of a photograph's matches, as the parallax of relief is correlated
# between neighbours.
_COUNTED = 40.0
_STEPS = 30  # most iterations of Levenberg-Marquardt
STEP = 1e-6  # of finite differences
# Prior standard deviations: of log d, if EXIF gives the field of view and if not; of the first
# camera's tilt, radians; of a feature's height, plane units; of the lens distortion, k1 and k2.
_KNOWN_FOCAL, _ASSUMED_FOCAL, TILT = 0.01, 0.1, 0.15
RELIEF, DISTORTION = 0.01, (0.03, 0.01)


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
_POSE, _TURN, _PLACE = 6, slice(0, 3), slice(3, 6)  # a pose: rotation vector and position


@dataclass(frozen=True)
class Adjusted:
    """Result of the bundle adjustment."""

    first: FlashSetup
    """Setup of the first photograph with the estimated tilt and field of view."""
    cameras: tuple[PosedCamera, ...]
    """Cameras of all photographs, the first one's first."""
    reprojection_errors: tuple[float, ...]
    """(photographs - 1,) median reprojection error of each, pixels."""


def adjust(
    setup: FlashSetup,
    pairs: Sequence[Pair],
    *,
    known: bool,
    relief: float = RELIEF,
    distortion: tuple[float, float] = DISTORTION,
) -> Adjusted:
    """Estimate the cameras of photographs from their matches with the first.

    Args:
        setup: of the first, from its coarse fit.
        pairs: matches of every other photograph.
        known: whether the field of view is known from EXIF.
        relief: prior standard deviation of a feature's height, plane units.
        distortion: prior standard deviations of the lens distortion, k1 and k2.
    """
    focal = _KNOWN_FOCAL if known else _ASSUMED_FOCAL
    initial = _Common(0.0, 0.0, 0.0, *setup.tilt)
    deviation = np.array([focal, *distortion, TILT, TILT])
    bundle = _Bundle(setup, pairs, np.array(initial), deviation, relief)
    initial_poses = [_initial_pose(initial.first_camera(setup), pair) for pair in pairs]
    start = torch.from_numpy(np.concatenate([bundle.prior, *initial_poses]))
    _, minimum = minimised(bundle.cost, bundle.quadratic, start, _STEPS, tolerance=1e-7)
    common, poses = bundle.parts(minimum.numpy())
    fitted = _Common(*common.tolist())
    cameras, errors = [fitted.first_camera(setup)], []
    for pair, pose in zip(pairs, poses, strict=True):
        cameras.append(fitted.camera(setup, pose, pair.focal))
        errors.append(float(np.median(np.hypot(*bundle.residuals(pair, common, pose)))))
    return Adjusted(fitted.adjusted(setup), tuple(cameras), tuple(errors))


class MatchedPoints(NamedTuple):
    """(3, n) features on the plane, and at a height above it, plane units."""

    points: Doubles
    raised: Doubles

    @staticmethod
    def of(first: PosedCamera, pair: Pair, height: float) -> MatchedPoints:
        """Raised along the first camera's rays, so that it sees both at the same coordinates."""
        points = first.on_plane(pair.first)
        return MatchedPoints(
            points, points + height * (first.place[:, None] - points) / first.place[2]
        )

    def reprojected(self, camera: PosedCamera, pair: Pair) -> tuple[Doubles, Doubles]:
        """(2, n) reprojection errors in the other photograph, pixels, and the height's parallax."""
        image = camera.sees(self.points)
        parallax = (camera.sees(self.raised) - image) / pair.pixel
        return (image - pair.second) / pair.pixel, parallax


@dataclass(frozen=True)
class _Bundle:
    """Huber cost of reprojection errors in the common parameters and every photograph's pose."""

    setup: FlashSetup
    """Camera and flash of the first photograph, from its coarse fit."""
    pairs: Sequence[Pair]
    """Matches of every other photograph."""
    prior: Doubles
    deviation: Doubles
    """(5,) Gaussian prior of the common parameters."""
    relief: float
    """Prior standard deviation of a feature's height, plane units."""

    @staticmethod
    def parts(vector: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """(5,) common parameters and (photographs - 1, 6) poses of a vector of all."""
        return vector[:_COMMON], vector[_COMMON:].reshape(-1, _POSE)

    def features(self, pair: Pair, common: Doubles) -> MatchedPoints:
        """MatchedPoints of a pair where the first camera of `common` sees them."""
        first = _Common(*common.tolist()).first_camera(self.setup)
        return MatchedPoints.of(first, pair, self.relief)

    def residuals(
        self,
        pair: Pair,
        common: Doubles,
        pose: Doubles,
        features: MatchedPoints | None = None,
    ) -> Doubles:
        """(2, n) reprojection errors of matches, pixels, less the part explained by relief.

        `features` are those of `common` if known.
        """
        camera = _Common(*common.tolist()).camera(self.setup, pose, pair.focal)
        features = features or self.features(pair, common)
        return less_relief(*features.reprojected(camera, pair))

    def cost(self, parameters: Tensor) -> float:
        """Cost of parameters (5 + 6 photographs,)."""
        common, poses = self.parts(parameters.numpy())
        prior = float(np.square((common - self.prior) / self.deviation).sum()) / 2.0
        both = zip(self.pairs, poses, strict=True)
        return prior + sum(_huber(self.residuals(pair, common, pose))[0] for pair, pose in both)

    def quadratic(self, parameters: Tensor) -> tuple[Tensor, Tensor]:
        """Its Gauss-Newton Hessian and gradient; a photograph's errors depend on its pose only."""
        common, poses = self.parts(parameters.numpy())
        shared, pose_indices = self.parts(np.arange(len(parameters)))
        normal, gradient = 1e-12 * np.eye(len(parameters)), np.zeros(len(parameters))
        normal[shared, shared] += self.deviation**-2
        gradient[shared] = (common - self.prior) / self.deviation**2
        for pair, pose, own in zip(self.pairs, poses, pose_indices, strict=True):
            features = self.features(pair, common)
            residual = self.residuals(pair, common, pose, features)
            changed = [self.residuals(pair, common + d, pose) for d in STEP * np.eye(_COMMON)]
            changed += [
                self.residuals(pair, common, pose + d, features) for d in STEP * np.eye(_POSE)
            ]
            jacobian = np.stack([((each - residual) / STEP).ravel() for each in changed], 1)
            weighted = jacobian * np.tile(_huber(residual)[1], 2)[:, None]
            indices = np.r_[shared, own]
            normal[np.ix_(indices, indices)] += weighted.T @ jacobian
            gradient[indices] += weighted.T @ residual.ravel()
        return torch.from_numpy(normal), torch.from_numpy(gradient)


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
    weight = min(1.0, _COUNTED / max(1, len(size)))
    cost = np.where(size < threshold, size**2 / 2.0, threshold * (size - threshold / 2.0))
    return weight * float(cost.sum()), weight * threshold / np.maximum(size, threshold)


def _initial_pose(first: PosedCamera, pair: Pair) -> Doubles:
    """(6,) pose of a camera from its homography to the first, without distortion."""
    lens = Lens(first.lens.focal * pair.focal)
    camera = camera_of(first.on_plane(pair.first), pair.second, lens)
    return np.concatenate([cv2.Rodrigues(camera.turn)[0].ravel(), camera.place])
