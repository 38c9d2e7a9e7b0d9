"""Inspection of a photograph before capture: its quality, highlight, relief and tilt."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from matcap.capture.exemplar.observation import Observation
from matcap.capture.exemplar.relief_spectrum import ReliefSpectrum
from matcap.capture.tilt import fit_photograph, tilt_document
from matcap.capture.verdict.highlight import highlight_profile
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.geometry import flash_mirror_point
from matcap.flash.light import FlashLight
from matcap.flash.plane import Plane, read_plane
from matcap.flash.rectify import picture_of
from matcap.flash.render import uniform_radiance
from matcap.photo.checks import CHECKS, Finding
from matcap.photo.inspect import Inspection, inspect_photo
from matcap.photo.load import load_photo
from matcap.photo.photo import FULL, Photo

_FEWEST, _MOST = 2, 6  # stops by which another exposure is darker


@dataclass(frozen=True)
class InspectedPhotograph:
    """Result of inspecting a photograph."""

    quality: Inspection
    """Checks of the photograph, each with a remedy for the next shot."""
    relief_spectrum: ReliefSpectrum | None
    """Band energies of relief and albedo; None if they cannot be measured."""
    tilt: Mapping[str, Any] | None = None
    """Estimates of the tilt by source, degrees (capture/tilt.py)."""


def inspect_file(
    path: Path,
    detail: int,
    fov: float | None = None,
    white: float | None = None,
) -> InspectedPhotograph:
    """Inspect a photograph after the same reading and coarse fit as in a capture.

    Args:
        path: of the photograph.
        detail: pixels along its long side.
        fov: field of view along that side, degrees; None for the file's metadata.
        white: value of white in floating-point files; None for the file's, or 1.

    Raises:
        MatcapError: the file cannot be read, or the coarse fit fails.
    """
    photo = load_photo(path, long_side=detail, fov=fov, noise=False, white=white)
    photo, coarse, plane = _rectified(photo)
    return InspectedPhotograph(
        _quality(photo, coarse, plane),
        Observation.of(plane, coarse).relief_spectrum(),
        tilt_document(coarse),
    )


def photograph_quality(photo: Photo) -> Inspection:
    """Checks of a photograph that was read at the resolution of its capture."""
    return _quality(*_rectified(photo))


def _rectified(photo: Photo) -> tuple[Photo, CoarseFit, Plane]:
    """The photograph with its tone curve undone, its coarse fit, and its plane."""
    coarse = fit_photograph(photo)
    photo = photo.linearised(coarse.tone)
    return photo, coarse, read_plane(photo, coarse.setup, photo.pixels.shape[1])


def _quality(photo: Photo, coarse: CoarseFit, plane: Plane) -> Inspection:
    inspected = inspect_photo(photo, coarse.setup.tilt)
    return replace(inspected, findings=(*inspected.findings, *_gloss(coarse, plane)))


def _gloss(coarse: CoarseFit, plane: Plane) -> tuple[Finding, ...]:
    """Findings on the highlight of the photograph: its contrast and the variation of its glints.

    A capture's re-rendering is compared with these two.
    """
    limit = plane.encoding.limit
    picture, valid = np.minimum(picture_of(plane.linear), limit), plane.valid.numpy()
    inside = valid | (picture > FULL * limit).any(axis=2)
    profile = highlight_profile((picture, picture), inside, valid, coarse.setup, limit)
    if profile is None or not profile.glossy:
        return (CHECKS["highlight"].finding(math.nan),)
    contrast = profile.contrast[0]
    bound = f", or more: {profile.clipped[0]:.0%} of the highlight is clipped"
    highlight = CHECKS["highlight"].finding(contrast, bound=bound if profile.bound else "")
    if profile.bound:
        highlight = replace(highlight, remedy=_darker(coarse, limit))
    findings = [replace(highlight, value=round(contrast, 3))]
    if profile.glints:
        deviation = math.hypot(*(before for before, _ in profile.glints))
        findings.append(CHECKS["glints"].finding(deviation, variation=math.expm1(deviation)))
    return tuple(findings)


def _darker(coarse: CoarseFit, limit: float) -> str:
    """Advice for a highlight that clips at `limit`: how many stops darker another exposure is.

    By the fitted radiance at the mirror point, which is an estimate beyond the limit.
    """
    x, y = flash_mirror_point(coarse.setup)
    point = torch.tensor([x, y, 0.0])[:, None, None]
    peak = float(uniform_radiance(coarse, FlashLight.of(coarse.setup, point))[0].max())
    stops = min(max(math.ceil(math.log2(max(peak / limit, 1.0)) + 0.5), _FEWEST), _MOST)
    return (
        f"Take one more photograph {stops} stops darker from the same place, and capture both: "
        "it measures what is clipped."
    )
