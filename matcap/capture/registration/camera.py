"""A camera with any pose over the plane, its lens, and points of the plane's grid.

The plane frame is the first photograph's (flash/geometry.py). A point p is q = turn (p - place) in
the frame of a camera, which looks down -z, x right, y up. Its ideal image coordinates are
u = d q_x / -q_z, v = d q_y / -q_z with d = 1 / tan(fov / 2), the long side in [-1, 1]; the lens
multiplies them by 1 + k1 r^2 + k2 r^4 ([brown1966], radial terms only).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.flash.geometry import OWN, Extent, FlashSetup, camera_in_plane, setup_rotation

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
        return PosedCamera(
            setup_rotation(setup).numpy(), place.numpy(), Lens(setup.distance, distortion)
        )

    def sees(self, points: Points) -> Points:
        """(2, ...) image coordinates of points (3, ...), as precise; NaN behind the camera."""
        turn, place = (each.astype(points.dtype) for each in (self.turn, self.place))
        x, y, z = np.tensordot(turn, points - place.reshape(3, *(1,) * (points.ndim - 1)), 1)
        depth = np.where(z < 0.0, -z, np.nan).astype(points.dtype)
        return self.lens.distorted(self.lens.focal * np.stack([x, y]) / depth)

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
        lens: its lens.
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


def grid_points(
    across: int, down: int, extent: Extent = OWN, rows: slice = slice(None)
) -> NDArray[np.float64]:
    """(3, down, across) plane points of a grid's texels, or of some of its rows.

    The layout is that of geometry.plane_points.
    """
    texel = extent.texel(across)
    x = (np.arange(across) + 0.5 - across / 2.0) * texel + extent.middle[0]
    y = (down / 2.0 - np.arange(down)[rows] - 0.5) * texel + extent.middle[1]
    return np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.zeros((len(y), across))])


def to_pixels(
    image: NDArray[np.float64], columns: int, rows: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Columns and rows of image coordinates (2, ...) for cv2.remap; -1e6 for NaN."""
    x = (image[0] + 1.0) * columns / 2.0 - 0.5
    y = (rows - image[1] * columns) / 2.0 - 0.5
    return (
        np.nan_to_num(x, nan=-1e6).astype(np.float32),
        np.nan_to_num(y, nan=-1e6).astype(np.float32),
    )


def transformed(homography: Points, points: Points) -> Points:
    """(2, ...) points of a plane after a homography (3, 3) of it."""
    x, y, w = np.tensordot(homography, np.stack([*points, np.ones_like(points[0])]), 1)
    return np.stack([x / w, y / w])
