"""Cameras of any pose over the plane, their bundle adjustment, and the covariance of the result.

The plane frame is the first photograph's (flash/geometry.py). A point p is q = turn (p - place) in
the frame of a camera, which looks down -z, x right, y up. Its ideal image coordinates are
u = d q_x / -q_z, v = d q_y / -q_z with d = 1 / tan(fov / 2), the long side in [-1, 1]; the lens
multiplies them by 1 + k1 r^2 + k2 r^4 ([brown1966], radial terms only).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.flash.geometry import OWN, Extent, FlashSetup, camera_in_plane, setup_rotation
from matcap.flash.least_squares import huber, jacobian, minimised

Doubles = NDArray[np.float64]
Points = NDArray[Any]  # of single or double precision

_ROUNDS = 12  # fixed-point iterations of undistortion; each gains two digits at a distortion of 3 %


@dataclass(frozen=True)
class Lens:
    """Pinhole lens with radial distortion about the image centre."""

    focal: float
    """Focal length d, in halves of the picture's long side."""
    distortion: tuple[float, float] = (0.0, 0.0)
    """(k1, k2) of its radial distortion."""

    def distorted(self, image: Points) -> Points:
        """Distort ideal image coordinates (2, ...)."""
        return image * self._magnification(image)

    def undistorted(self, image: Doubles) -> Doubles:
        """Undistort image coordinates (2, ...); the inverse of distorted()."""
        ideal = image
        for _ in range(_ROUNDS if any(self.distortion) else 0):
            ideal = image / self._magnification(ideal)
        return ideal

    def _magnification(self, ideal: Points) -> Points:
        """(...) 1 + k1 r^2 + k2 r^4 of ideal image coordinates (2, ...)."""
        k1, k2 = self.distortion
        squared = np.square(ideal).sum(0)
        return np.asarray(1.0 + squared * (k1 + squared * k2))


@dataclass(frozen=True)
class PosedCamera:
    """Camera with pose and lens, in the plane frame."""

    turn: Doubles
    """(3, 3) rotation from the plane frame to the camera's."""
    place: Doubles
    """(3,) position of the camera in the plane frame, plane units."""
    lens: Lens
    """Focal length and distortion."""

    @staticmethod
    def of(setup: FlashSetup, distortion: tuple[float, float] = (0.0, 0.0)) -> PosedCamera:
        """The first photograph's camera, which defines the plane frame; with its (k1, k2)."""
        place, _ = camera_in_plane(setup)
        turn, lens = setup_rotation(setup).numpy(), Lens(setup.distance, distortion)
        return PosedCamera(turn, place.numpy(), lens)

    def sees(self, points: Points) -> Points:
        """(2, ...) image coordinates of points (3, ...), as precise; NaN behind the camera."""
        turn, place = (each.astype(points.dtype) for each in (self.turn, self.place))
        x, y, z = np.tensordot(turn, points - place.reshape(3, *(1,) * (points.ndim - 1)), 1)
        depth = np.where(z < 0.0, -z, np.nan).astype(points.dtype)
        return self.lens.distorted(self.lens.focal * np.stack([x, y]) / depth)

    def shows(self, points: Doubles, up: float, steepest: float) -> NDArray[np.bool_]:
        """(h, w) whether plane points (3, h, w) project into a picture, at less than an angle.

        Args:
            points: with z = 0, plane units.
            up: height of the picture over its width.
            steepest: largest angle of a ray to the plane's normal, degrees.
        """
        to_camera = self.place.reshape(3, 1, 1) - points
        upright = to_camera[2] > math.cos(math.radians(steepest)) * np.sqrt(
            np.square(to_camera).sum(0)
        )
        u, v = self.sees(points)
        # Far outside of the picture, the lens's polynomial can map points back into it.
        near = np.abs(replace(self, lens=Lens(self.lens.focal)).sees(points)).max(0) < 1.5
        return np.asarray(upright & near & (np.abs(u) < 1.0) & (np.abs(v) < up))

    def on_plane(self, image: Doubles) -> Doubles:
        """(3, ...) plane points at image coordinates (2, ...); the inverse of sees()."""
        u, v = self.lens.undistorted(image)
        ray = np.tensordot(self.turn.T, np.stack([u, v, np.full_like(u, -self.lens.focal)]), 1)
        column = self.place.reshape(3, *(1,) * (ray.ndim - 1))
        points = column - column[2] / ray[2] * ray
        points[2] = 0.0
        return np.asarray(points)

    def flash(self, offset: tuple[float, float, float]) -> Doubles:
        """(3,) flash position in the plane frame; `offset` from the lens is in the camera frame."""
        return self.place + self.turn.T @ np.asarray(offset)

    @property
    def tilt(self) -> float:
        """Angle between optical axis and plane normal, radians."""
        return float(np.arccos(np.clip(self.turn[2, 2], -1.0, 1.0)))


def camera_of(points: Doubles, image: Doubles, lens: Lens, *, refined: bool = False) -> PosedCamera:
    """The camera that sees plane points (3, n) at image coordinates (2, n) [collins2014].

    Args:
        points: with z = 0, plane units.
        image: where it sees them.
        refined: whether to minimise the reprojection error by Levenberg-Marquardt.
    """
    # OpenCV's camera looks along +z with y downwards.
    ideal = (lens.undistorted(image) * np.array([[1.0], [-1.0]])).T.copy()
    known = points.T.copy(), ideal, np.diag([lens.focal, lens.focal, 1.0]), None
    _, turn, shift = cv2.solvePnP(*known, flags=cv2.SOLVEPNP_IPPE)
    if refined:
        turn, shift = cv2.solvePnPRefineLM(*known, turn, shift)
    rotation = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
    return PosedCamera(np.diag([1.0, -1.0, -1.0]) @ rotation, -rotation.T @ shift.ravel(), lens)


def grid_points(across: int, down: int, extent: Extent = OWN, rows: slice = slice(None)) -> Doubles:
    """(3, down, across) plane points of a grid's texels, or of some of its rows.

    The layout is that of geometry.plane_points.
    """
    texel = extent.texel(across)
    x = (np.arange(across) + 0.5 - across / 2.0) * texel + extent.middle[0]
    y = (down / 2.0 - np.arange(down)[rows] - 0.5) * texel + extent.middle[1]
    return np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.zeros((len(y), across))])


def to_pixels(
    image: Doubles, columns: int, rows: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Columns and rows of image coordinates (2, ...) for cv2.remap; -1e6 for NaN."""
    x = np.nan_to_num((image[0] + 1.0) * columns / 2.0 - 0.5, nan=-1e6)
    y = np.nan_to_num((rows - image[1] * columns) / 2.0 - 0.5, nan=-1e6)
    return x.astype(np.float32), y.astype(np.float32)


def transformed(homography: Points, points: Points) -> Points:
    """(2, ...) points of a plane after a homography (3, 3) of it."""
    x, y, w = np.tensordot(homography, np.stack([*points, np.ones_like(points[0])]), 1)
    return np.stack([x / w, y / w])


# Bundle adjustment of all cameras and their common lens over all feature matches.
#
# Matches are between the first photograph, which defines the plane frame up to its tilt, and every
# other one. The Huber cost of reprojection errors is minimised (flash/least_squares.py); the
# residuals of a photograph depend on its six pose parameters and the common ones only.

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


# Parameters of all photographs: log of the camera distance over the setup's, k1 and k2 of the lens,
# and the first camera's tilt about x and y.
_COMMON = 5


def _adjusted(setup: FlashSetup, common: Doubles) -> FlashSetup:
    """The first photograph's setup with the field of view and tilt of common parameters (5,)."""
    distance = setup.distance * math.exp(common[0])
    fov = 2.0 * math.degrees(math.atan(1.0 / distance))
    return replace(setup, fov=fov, tilt=(float(common[3]), float(common[4])))


@dataclass(frozen=True)
class Adjusted:
    """Result of the bundle adjustment."""

    first: FlashSetup
    """Setup of the first photograph with the estimated tilt and field of view."""
    cameras: tuple[PosedCamera, ...]
    """Cameras of all photographs, the first one's first."""
    reprojection_errors: tuple[float, ...]
    """(photographs - 1,) median reprojection error of each, pixels."""
    bundle: _Bundle
    """The cost that they minimise."""
    parameters: Doubles
    """(5 + 6 (photographs - 1),) where it has its minimum."""


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
    prior, deviation = np.r_[0.0, 0.0, 0.0, setup.tilt], np.array([focal, *distortion, TILT, TILT])
    bundle = _Bundle(setup, pairs, prior, deviation, relief)
    poses = [_initial_pose(PosedCamera.of(setup), pair) for pair in pairs]
    start = np.concatenate([bundle.prior, *poses])
    _, values = minimised(bundle.cost, bundle.quadratic, start, _STEPS, tolerance=1e-7)
    cameras, errors = [bundle.first_camera(values)], []
    for pair, block in bundle.blocks:
        fitted = values[block]
        cameras.append(bundle.cameras(pair, fitted)[1])
        errors.append(float(np.median(np.hypot(*bundle.residuals(pair, fitted)))))
    return Adjusted(_adjusted(setup, values), tuple(cameras), tuple(errors), bundle, values)


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

    @property
    def blocks(self) -> Iterator[tuple[Pair, NDArray[np.int64]]]:
        """Each pair with the indices of the parameters (11,) on which its residuals depend: the
        common ones, and its photograph's rotation vector and position.
        """
        for number, pair in enumerate(self.pairs):
            yield pair, np.r_[:_COMMON, _COMMON + 6 * number + np.arange(6)]

    def first_camera(self, parameters: Doubles) -> PosedCamera:
        """The first photograph's, of parameters that begin with the common ones."""
        distortion = float(parameters[1]), float(parameters[2])
        return PosedCamera.of(_adjusted(self.setup, parameters), distortion)

    def cameras(self, pair: Pair, parameters: Doubles) -> tuple[PosedCamera, PosedCamera]:
        """The first photograph's camera and that of a pair's, of parameters (11,)."""
        first = self.first_camera(parameters)
        turn = np.asarray(cv2.Rodrigues(parameters[_COMMON:-3])[0], np.float64)
        lens = replace(first.lens, focal=first.lens.focal * pair.focal)
        return first, PosedCamera(turn, parameters[-3:], lens)

    def residuals(self, pair: Pair, parameters: Doubles) -> Doubles:
        """(2, n) reprojection errors of parameters (11,), pixels, less what relief explains."""
        return less_relief(*reprojected(*self.cameras(pair, parameters), pair, self.relief))

    def cost(self, values: Doubles) -> float:
        """Cost of parameters (5 + 6 pairs,)."""
        prior = float(np.square((values[:_COMMON] - self.prior) / self.deviation).sum()) / 2.0
        return prior + sum(_huber(self.residuals(pair, values[at]))[0] for pair, at in self.blocks)

    def quadratic(self, values: Doubles) -> tuple[Doubles, Doubles]:
        """Its Gauss-Newton Hessian and gradient."""
        normal, gradient = 1e-12 * np.eye(len(values)), np.zeros(len(values))
        normal[:_COMMON, :_COMMON] += np.diag(self.deviation**-2)
        gradient[:_COMMON] = (values[:_COMMON] - self.prior) / self.deviation**2
        for pair, block in self.blocks:
            residuals = partial(self.residuals, pair)
            residual = residuals(values[block])
            derivative = jacobian(residuals, values[block], STEP)
            weighted = derivative * np.tile(_huber(residual)[1], 2)[:, None]
            normal[np.ix_(block, block)] += weighted.T @ derivative
            gradient[block] += weighted.T @ residual.ravel()
        return normal, gradient


def reprojected(
    first: PosedCamera, camera: PosedCamera, pair: Pair, relief: float
) -> tuple[Doubles, Doubles]:
    """(2, n) reprojection errors of matches, pixels, and parallax of features `relief` higher.

    A feature is raised along the first camera's ray, so its place in the first photograph is the
    same.
    """
    points = first.on_plane(pair.first)
    raised = points + relief * (first.place[:, None] - points) / first.place[2]
    image = camera.sees(points)
    return (image - pair.second) / pair.pixel, (camera.sees(raised) - image) / pair.pixel


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
    loss, weight = huber(np.hypot(*residuals), _HUBER)
    count = min(1.0, _COUNTED / max(1, len(loss)))
    return count * float(loss.sum()), count * weight


def _initial_pose(first: PosedCamera, pair: Pair) -> Doubles:
    """(6,) pose of a camera from its homography to the first, without distortion."""
    lens = Lens(first.lens.focal * pair.focal)
    camera = camera_of(first.on_plane(pair.first), pair.second, lens)
    return np.concatenate([cv2.Rodrigues(camera.turn)[0].ravel(), camera.place])


# Covariance of the bundle-adjusted cameras.
#
# Random errors of features average out; those of shading do not. The lit side of a bump follows the
# flash, like a point at another depth (a highlight like the bump's centre of curvature), by the
# same depth for all bumps of a material. This common depth cannot be estimated from the matches, as
# a plane at that depth gives the same ones; its standard deviation is taken from the apparent
# depths of single features. It is a consider parameter: in the covariance, but not estimated
# [schmidt1966].

# Prior standard deviations and noise model; docs/notes/several.md.
# Standard deviation of the features' common apparent depth over that of single ones.
_COMMON_DEPTH = 3.0
# Tangent of the light's angle at which the displacement by shading is half the linear one.
_SATURATED = 0.5
_INDEPENDENT = 0.25  # share of features that are independent (do not overlap others)


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

    `fit` are cameras after bundle adjustment to `pairs`.
    """
    bundle = replace(fit.bundle, pairs=pairs, relief=RELIEF)
    covariance, positions, misregistration = _covariance(bundle, fit.parameters), [], []
    for pair, block in bundle.blocks:
        values, own = fit.parameters[block], covariance[np.ix_(block, block)]
        first, camera = bundle.cameras(pair, values)
        farther = float(np.linalg.norm(camera.place) / np.linalg.norm(first.place))
        variance = _variance(partial(_baseline, bundle, pair), values, own)
        positions.append(math.sqrt(float(variance.sum())) / farther)
        points = grid_points(16, 12).reshape(3, -1)
        both = (np.abs(camera.sees(points)) < 1.0).all(0)
        image = first.sees(points[:, both] if both.any() else points)
        variance = _variance(partial(_registered, bundle, pair, image, camera), values, own)
        misregistration.append(math.sqrt(2.0 * float(variance.mean())))
    return CameraDeviations(np.array(positions), np.array(misregistration))


def _baseline(bundle: _Bundle, pair: Pair, parameters: Doubles) -> Doubles:
    """(3,) position of a pair's camera in the frame of the first, over the first one's distance."""
    first, camera = bundle.cameras(pair, parameters)
    return np.asarray(first.turn @ (camera.place - first.place) / np.linalg.norm(first.place))


def _registered(
    bundle: _Bundle, pair: Pair, image: Doubles, estimated: PosedCamera, parameters: Doubles
) -> Doubles:
    """(2, n) plane points that the estimated camera takes for those at `image` in the first."""
    first, camera = bundle.cameras(pair, parameters)
    return estimated.on_plane(camera.sees(first.on_plane(image)))[:2]


def _covariance(bundle: _Bundle, values: Doubles) -> Doubles:
    """(n, n) covariance of the bundle's parameters at `values` (n,), error by shading included."""
    normal, gradient = 1e-9 * np.eye(len(values)), np.zeros(len(values))
    normal[:_COMMON, :_COMMON] += np.diag(bundle.deviation**-2)
    depths = []
    for pair, block in bundle.blocks:
        first, camera = bundle.cameras(pair, values[block])
        residual, parallax = reprojected(first, camera, pair, bundle.relief)
        noise, depth = _scatter(residual, parallax)
        depths.append(depth)
        derivative = jacobian(partial(bundle.residuals, pair), values[block], STEP)
        by_depth = less_relief(_shading(first, camera, pair), parallax)
        # Matches beyond four standard deviations are outliers, with weight 0.
        kept = np.tile(np.hypot(*less_relief(residual, parallax)) < 4.0 * noise, 2)
        weighted = derivative.T * (_INDEPENDENT * kept / noise**2)
        normal[np.ix_(block, block)] += weighted @ derivative
        gradient[block] += weighted @ by_depth.ravel()
    covariance = np.asarray(np.linalg.inv(normal), np.float64)
    by_shading = _COMMON_DEPTH * float(np.median(depths or [0.0])) * (covariance @ gradient)
    return covariance + np.outer(by_shading, by_shading)


def _scatter(residual: Doubles, parallax: Doubles) -> tuple[float, float]:
    """Standard deviation of matches, pixels, and of their apparent depth, plane units."""
    length = np.maximum(np.hypot(*parallax), 1e-9)
    along = (residual * parallax).sum(0) / length
    across = (residual[0] * parallax[1] - residual[1] * parallax[0]) / length
    noise = max(1.48 * float(np.nanmedian(np.abs(across))), 0.05)
    pixels = float(np.nanmedian(length)) / RELIEF
    return noise, 1.48 * float(np.nanmedian(np.abs(along))) / pixels


def _shading(first: PosedCamera, camera: PosedCamera, pair: Pair) -> Doubles:
    """(2, n) displacement by shading between two flashes, pixels per plane unit of depth."""
    points = first.on_plane(pair.first)

    def displacement(flash: Doubles) -> Doubles:
        tangent = (flash[:2, None] - points[:2]) / flash[2]
        return np.asarray(tangent / (1.0 + np.square(tangent).sum(0) / _SATURATED**2))

    across = displacement(camera.place) - displacement(first.place)
    shift = np.concatenate([across, np.zeros_like(points[2:])])
    return (camera.sees(points + STEP * shift) - camera.sees(points)) / (STEP * pair.pixel)


def _variance(f: Callable[[Doubles], Doubles], at: Doubles, covariance: Doubles) -> Doubles:
    """(n,) variances of f(parameters), flattened, by linear propagation of their covariance."""
    derivative = jacobian(f, at, STEP)
    return np.asarray(np.einsum("ni,ij,nj->n", derivative, covariance, derivative))
