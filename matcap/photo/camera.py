"""Camera profile: falloff towards the corners and tone curve, estimated from several photographs.

The falloff of an LED's cone, the lens's vignetting and the tone curve are properties of the camera.
They are estimated together by flash/camera_profile.py.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import UsageError
from matcap.files.staging import staged_file
from matcap.files.values import bounded, whole

LEAST = 5  # least number of photographs for a profile
FORMAT = "matcap camera profile"
VERSION = 1
_MOST_BYTES = 100_000
_MOST_LOST = 20.0  # largest magnitude of coefficients, as in material files
_FIXED = 1e-4  # standard deviation of what is known


@dataclass(frozen=True)
class CameraResponse:
    """Gaussian distribution of (a, b, log c): falloff coefficients and the tone curve's exponent.

    The falloff is exp(-a s - b s^2), s = r^2 / 1.25^2, so that s = 1 in the corners of a 4:3
    picture (FlashSetup); c is ToneCurve's. The default is a wide prior for phones: 39 photographs
    by one of them had a + b = 1.07 on average (0.88 to 1.63), and 95 a median of c of 1.2.
    """

    mean: tuple[float, float, float] = (0.3, 0.5, 0.12)
    """Means of a, b and log c."""
    covariance: tuple[tuple[float, float, float], ...] = (
        (0.35**2, 0.0, 0.0),
        (0.0, 0.7**2, 0.0),
        (0.0, 0.0, 0.08**2),
    )
    """(3, 3) covariance, symmetric and positive definite."""

    @property
    def deviation(self) -> tuple[float, float, float]:
        """Standard deviations."""
        first, second, third = np.sqrt(np.diagonal(np.array(self.covariance))).tolist()
        return first, second, third

    @property
    def precision(self) -> NDArray[np.float64]:
        """(3, 3) inverse of the covariance."""
        return np.asarray(np.linalg.inv(np.array(self.covariance)), np.float64)

    @property
    def linear(self) -> CameraResponse:
        """The same of a picture without a tone curve: c is 1."""
        (aa, ab, _), (_, bb, _), _ = self.covariance
        fixed = ((aa, ab, 0.0), (ab, bb, 0.0), (0.0, 0.0, _FIXED**2))
        return CameraResponse((*self.mean[:2], 0.0), fixed)


@dataclass(frozen=True)
class CameraProfile:
    """Falloff of one camera."""

    camera: str
    """Maker, model, lens, focal length and zoom."""
    response: CameraResponse
    """Its covariance includes the scatter between photographs."""
    photographs: int
    """Number of photographs it was estimated from."""

    def document(self) -> dict[str, Any]:
        """The profile for JSON."""
        return {
            "camera": self.camera,
            "photographs": self.photographs,
            "mean": list(self.response.mean),
            "covariance": [list(row) for row in self.response.covariance],
        }

    def says(self) -> str:
        """The profile as a sentence for the user."""
        first, second, exponent = self.response.mean
        return (
            f"Profile of {self.camera} over {self.photographs} photographs: its corners get "
            f"{np.exp(-first - second):.0%} of the middle's light, and its tone curve raises "
            f"contrast to the power {np.exp(exponent):.2f}."
        )


def write_camera_profile(path: Path, profile: CameraProfile) -> None:
    """Write a profile as JSON; equal profiles give equal bytes.

    Raises:
        MatcapError: the file cannot be written.
    """
    document = {"format": FORMAT, "version": VERSION, **profile.document()}
    with staged_file(path) as file:
        file.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def read_camera_profile(path: Path) -> CameraProfile:
    """Read and check a profile's file.

    Raises:
        UsageError: the file cannot be read, is not a profile, or has values out of range.
    """
    remedy = "give a file that matcap camera or matcap batch wrote"
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise ValueError("it is too large")
        document = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise ValueError("it is none")
        if document.get("version") != VERSION:
            raise ValueError(f"its version is {document.get('version')!r:.20}, not {VERSION}")
        return _checked(document)
    except OSError as error:
        why = f"the camera's profile cannot be read ({error.strerror})"
        raise UsageError(why, where=str(path), remedy=remedy) from error
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        said = f"{error} is missing" if isinstance(error, KeyError) else error
        why = f"this is no camera's profile ({said})"
        raise UsageError(why, where=str(path), remedy=remedy) from error


def _checked(document: dict[str, Any]) -> CameraProfile:
    def triple(values: object, key: str, least: float) -> tuple[float, float, float]:
        if not isinstance(values, list) or len(values) != 3:
            raise ValueError(f"{key} is not three numbers")
        first, second, third = (bounded(value, key, least, _MOST_LOST) for value in values)
        return first, second, third

    if not isinstance(document["camera"], str):
        raise ValueError("camera is not a text")
    rows = document["covariance"]
    if not isinstance(rows, list) or len(rows) != 3:
        raise ValueError("covariance is not three rows")
    first, second, third = (triple(row, "covariance", -_MOST_LOST) for row in rows)
    matrix = np.array([first, second, third])
    if not np.array_equal(matrix, matrix.T) or np.linalg.eigvalsh(matrix)[0] < _FIXED**2:
        raise ValueError("covariance is not symmetric and positive definite")
    return CameraProfile(
        document["camera"][:200],
        CameraResponse(triple(document["mean"], "mean", -_MOST_LOST), (first, second, third)),
        whole(document["photographs"], "photographs", 1, 1_000_000),
    )
