"""A camera's profile: how much light it loses towards the corners, estimated over a shoot.

A phone's LED lights a cone, which a RAW shows as well, and a lens darkens its corners. Both belong
to the camera, whatever it photographs; flash/camera_profile.py estimates them.
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

LEAST = 5  # photographs that make a profile: fewer are no shoot
FORMAT = "matcap camera profile"
VERSION = 1
_MOST_BYTES = 100_000
_MOST_LOST = 20.0  # as in material files


@dataclass(frozen=True)
class Falloff:
    """Gaussian of FlashSetup's coefficients (a, b): exp(-a s - b s^2) of the light is left.

    s = r^2 / 1.25^2, 1 in the corners of a 4:3 picture, where a + b is the logarithm of what is
    lost. By default any phone's: fitted on 39 matte photographs of one the sum is 1.07 (0.88 to
    1.63); others, and lamps without a cone, differ.
    """

    mean: tuple[float, float] = (0.3, 0.5)
    """Of a and b."""
    deviation: tuple[float, float] = (0.35, 0.7)
    """Standard, of each."""
    correlation: float = 0.0
    """Of the two: photographs determine their sum better than either."""

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(2, 2)."""
        first, second = self.deviation
        both = self.correlation * first * second
        return np.array([[first**2, both], [both, second**2]])

    @property
    def precision(self) -> NDArray[np.float64]:
        """(2, 2) inverse of the covariance."""
        return np.asarray(np.linalg.inv(self.covariance), np.float64)


@dataclass(frozen=True)
class CameraProfile:
    """What photographs of one camera say together."""

    camera: str
    """Its name: maker, model, lens, focal length and zoom, or what else its photographs share."""
    falloff: Falloff
    """Mean and deviations, the scatter between photographs included."""
    photographs: int
    """How many it was estimated over."""

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "camera": self.camera,
            "photographs": self.photographs,
            "falloff": list(self.falloff.mean),
            "deviation": list(self.falloff.deviation),
            "correlation": self.falloff.correlation,
        }

    def says(self) -> str:
        """In a sentence."""
        left = np.exp(-sum(self.falloff.mean))
        return (
            f"Profile of {self.camera} over {self.photographs} photographs: its corners get "
            f"{left:.0%} of the middle's light."
        )


def write_camera_profile(path: Path, profile: CameraProfile) -> None:
    """Write a profile as JSON; the same profile is the same bytes.

    Raises:
        MatcapError: the file cannot be written.
    """
    document = {"format": FORMAT, "version": VERSION, **profile.document()}
    with staged_file(path) as file:
        file.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def read_camera_profile(path: Path) -> CameraProfile:
    """Read a profile's file, with checks.

    Raises:
        UsageError: it cannot be read, is none, or says what no camera does.
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
