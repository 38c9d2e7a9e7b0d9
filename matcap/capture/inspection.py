"""What can be said of a photograph before it is captured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matcap.capture.piece.strengths import Strengths
from matcap.capture.piece.told import photographed_strengths
from matcap.capture.tilt import fitted, tilt_document
from matcap.flash.coarse import CoarseFit
from matcap.photo.camera import CameraProfile
from matcap.photo.inspect import Inspection, inspect_photo
from matcap.photo.load import load_photo
from matcap.photo.photo import Photo


@dataclass(frozen=True)
class InspectedPhotograph:
    """A photograph looked at.

    Attributes:
        quality: how good it is, and what to do at the next shot.
        strengths: of relief and albedo, where they are told outright.
        tilt: what the branch and what the picture says of it (capture/tilt.py).
    """

    quality: Inspection
    strengths: Strengths | None
    tilt: Mapping[str, Any] | None = None


def inspect_file(
    path: Path, detail: int, fov: float | None = None, profile: CameraProfile | None = None
) -> InspectedPhotograph:
    """Look at a photograph as a capture would.

    Args:
        path: of the photograph.
        detail: pixels across its long side.
        fov: field of view along that side, degrees; None for what the file says.
        profile: of the camera, if it is known.

    Raises:
        MatcapError: it cannot be read, or nothing can be fitted to it.
    """
    photo = load_photo(path, long_side=detail, fov=fov, noise=False)
    photo = photo if profile is None else photo.known_by(profile)
    coarse = fitted(photo)
    strengths = photographed_strengths(photo, coarse, photo.pixels.shape[1])
    return InspectedPhotograph(photograph_quality(photo, coarse), strengths, tilt_document(coarse))


def photograph_quality(photo: Photo, coarse: CoarseFit | None = None) -> Inspection:
    """How good a photograph is.

    Args:
        photo: read at the detail it is captured at.
        coarse: its fit, or None to find it.
    """
    return inspect_photo(photo, (coarse or fitted(photo)).setup.tilt)
