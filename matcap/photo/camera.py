"""Camera profile: the falloff towards the corners, estimated from several photographs.

The falloff of an LED's cone and the lens's vignetting are properties of the camera. They are
estimated together by capture/camera_profile.py.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matcap.errors import UsageError
from matcap.files.output import Output
from matcap.files.values import bounded, whole

LEAST = 5  # least number of photographs for a profile
FORMAT = "matcap camera profile"
VERSION = 1
_MOST_BYTES = 100_000
_MOST_LOST = 20.0  # largest magnitude of coefficients, as in material files


@dataclass(frozen=True)
class Falloff:
    """Gaussian distribution of FlashSetup's falloff coefficients (a, b).

    The falloff is exp(-a s - b s^2), s = r^2 / 1.25^2, so that s = 1 in the corners of a 4:3
    picture. The default is a wide prior for phones: 95 photographs by one of them had a + b = 0.73
    on the median, with a deviation of 0.35.
    """

    mean: tuple[float, float] = (0.3, 0.5)
    """Means of a and b."""
    deviation: tuple[float, float] = (0.35, 0.7)
    """Standard deviations of a and b."""
    correlation: float = 0.0
    """Correlation of a and b; negative for profiles, as photographs determine a + b best."""

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(2, 2) covariance of a and b."""
        first, second = self.deviation
        both = self.correlation * first * second
        return np.array([[first**2, both], [both, second**2]])

    @property
    def precision(self) -> NDArray[np.float64]:
        """(2, 2) inverse of the covariance."""
        return np.asarray(np.linalg.inv(self.covariance), np.float64)


@dataclass(frozen=True)
class CameraProfile:
    """Falloff of one camera."""

    camera: str
    """Maker, model, lens, focal length and zoom."""
    falloff: Falloff
    """Falloff of the next photograph: its standard deviations include the scatter between them."""
    photographs: int
    """Number of photographs it was estimated from."""

    def document(self) -> dict[str, Any]:
        """The profile for JSON."""
        return {
            "camera": self.camera,
            "photographs": self.photographs,
            "falloff": list(self.falloff.mean),
            "deviation": list(self.falloff.deviation),
            "correlation": self.falloff.correlation,
        }

    def says(self) -> str:
        """The profile as a sentence for the user."""
        left = np.exp(-sum(self.falloff.mean))
        return (
            f"Profile of {self.camera} over {self.photographs} photographs: its corners get "
            f"{left:.0%} of the middle's light."
        )


def write_camera_profile(path: Path, profile: CameraProfile) -> None:
    """Write a profile as JSON; equal profiles give equal bytes.

    Raises:
        MatcapError: the file cannot be written.
    """
    document = {"format": FORMAT, "version": VERSION, **profile.document()}
    with Output.file(path) as file:
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
        raise UsageError.at(path, why, remedy) from error
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        said = f"{error} is missing" if isinstance(error, KeyError) else error
        why = f"this is not a camera profile ({said})"
        raise UsageError.at(path, why, remedy) from error


def _checked(document: dict[str, Any]) -> CameraProfile:
    def pair(key: str, least: float) -> tuple[float, float]:
        values = document[key]
        if not isinstance(values, list) or len(values) != 2:
            raise ValueError(f"{key} is not two numbers")
        first, second = (bounded(value, key, least, _MOST_LOST) for value in values)
        return first, second

    if not isinstance(document["camera"], str):
        raise ValueError("camera is not a text")
    return CameraProfile(
        document["camera"][:200],
        Falloff(
            pair("falloff", -_MOST_LOST),
            pair("deviation", 1e-4),
            bounded(document["correlation"], "correlation", -0.999, 0.999),
        ),
        whole(document["photographs"], "photographs", 1, 1_000_000),
    )
