"""Inspection before capture: quality, highlight and tilt of one photograph, coverage of several."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import torch

from matcap.capture.bracket import MERGED
from matcap.capture.exemplar.estimate import measured_spectrum
from matcap.capture.exemplar.relief_spectrum import ReliefSpectrum
from matcap.capture.multiview.mosaic import mosaic_of
from matcap.capture.rectified import Observation, fit_photograph, tilt_document
from matcap.capture.registration.camera import grid_points
from matcap.capture.registration.keypoints import LONG_SIDE
from matcap.capture.registration.register import RegisteredView, Registration, register_in_any_order
from matcap.capture.verdict.causes import highlight_profile
from matcap.capture.verdict.measurements import clipped_at
from matcap.errors import MatcapError
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.geometry import flash_mirror_point
from matcap.flash.highlight import limit_sparkles
from matcap.flash.light import FlashLight, uniform_radiance
from matcap.flash.rectify import Plane, picture_of, read_plane
from matcap.photo.checks import CHECKS, Finding, Rating
from matcap.photo.inspect import Inspection, inspect_photo
from matcap.photo.load import load_photo
from matcap.photo.photo import FULL, Photo

# Inspection of a photograph before capture: its quality, highlight, relief and tilt.

_MOSTLY = 0.25  # clipped share of a highlight from which its strength is not measured
_CORE = 1.5  # severity of that, of the photograph: its maps may look right under the flash
_FEWEST, _MOST = 2, 6  # stops by which another exposure is darker


@dataclass(frozen=True)
class InspectedPhotograph:
    """Result of inspecting a photograph."""

    quality: Inspection
    """Checks of the photograph, each with a remedy for the next shot."""
    relief_spectrum: ReliefSpectrum | None
    """Band energies of relief and albedo; None if they cannot be measured."""
    tilt: Mapping[str, Any] | None = None
    """Estimates of the tilt by source, degrees (capture/rectified.py)."""


def inspect_file(
    path: Path, detail: int, fov: float | None = None, white: float | None = None
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
    return inspected(load_photo(path, long_side=detail, fov=fov, noise=False, white=white))


def inspected(photo: Photo) -> InspectedPhotograph:
    """Inspect a photograph that was read at the resolution of its capture, or a merged bracket.

    Raises:
        MatcapError: the coarse fit fails.
    """
    photo, coarse, plane = _rectified(photo)
    return InspectedPhotograph(
        checked(photo, coarse, plane),
        measured_spectrum(Observation.of(plane, coarse)),
        tilt_document(coarse),
    )


def photograph_quality(photo: Photo) -> Inspection:
    """Checks of a photograph that was read at the resolution of its capture."""
    return checked(*_rectified(photo))


def _rectified(photo: Photo) -> tuple[Photo, CoarseFit, Plane]:
    """The photograph with its tone curve undone, its coarse fit, and its plane."""
    photo = limit_sparkles(photo)
    coarse = fit_photograph(photo)
    photo = photo.linearised(coarse.tone)
    return photo, coarse, read_plane(photo, coarse.setup, photo.pixels.shape[1])


def checked(photo: Photo, coarse: CoarseFit, plane: Plane) -> Inspection:
    """Checks of a photograph with those of its highlight, as `inspect` and a capture state them.

    A capture's re-rendering is compared with the highlight and its glints.
    """
    offset = math.hypot(*coarse.setup.offset[:2])
    inspected = inspect_photo(photo, coarse.setup.tilt).with_finding(
        CHECKS["flash_offset"].finding(offset, off=50.0 * offset)
    )
    limit = plane.encoding.limit
    picture, valid = clipped_at(picture_of(plane.linear), limit), plane.valid.numpy()
    inside = valid | (picture > FULL * limit).any(axis=2)
    profile = highlight_profile((picture, picture), inside, valid, coarse.setup, limit)
    if profile is None or not profile.glossy:
        spot = inspected["hot_spot"]
        if profile is not None and not spot.rating.fit:  # of a matte sample it does not say much
            inspected = inspected.with_finding(replace(spot, rating=Rating.USABLE, severity=_CORE))
        return inspected.with_finding(CHECKS["highlight"].finding(math.nan))
    clipped = 100.0 * profile.clipped[0]
    more = f", or more: {clipped:.0f} % of it is clipped" if profile.bound else ""
    if profile.glints:
        variation = math.expm1(math.hypot(*(before for before, _ in profile.glints)))
        more += f"; its glints vary by {100.0 * variation:.0f} %"
    inspected = inspected.with_finding(CHECKS["highlight"].finding(profile.contrast[0], more=more))
    if profile.clipped[0] <= _MOSTLY:
        return inspected
    # What limits a capture limits the photograph.
    whole, says = inspected["clipped"], f", and {clipped:.0f} % of its highlight"
    return inspected.with_finding(
        replace(
            whole,
            says=f"{whole.says}{says}",
            remedy=_darker(coarse, limit, any(note.startswith(MERGED) for note in photo.notes)),
            rating=Rating.of(max(whole.severity, _CORE)),
        )
    )


def _darker(coarse: CoarseFit, limit: float, merged: bool) -> str:
    """Advice for a highlight that clips at `limit`: how many stops darker another exposure is.

    Than the darkest of those that were `merged`. By the fitted radiance at the mirror point, which
    is an estimate beyond the limit.
    """
    x, y = flash_mirror_point(coarse.setup)
    point = torch.tensor([x, y, 0.0])[:, None, None]
    peak = float(uniform_radiance(coarse, FlashLight.of(coarse.setup, point))[0].max())
    stops = min(max(math.ceil(math.log2(max(peak / limit, 1.0)) + 0.5), _FEWEST), _MOST)
    than, them = (" than the darkest", "all") if merged else ("", "both")
    return (
        f"take one more photograph {stops} stops darker{than} from the same place, and capture "
        f"{them}: it measures what is clipped"
    )


# Coverage checks of several photographs before capture: views, light directions, overlap.
#
# Photographs are registered as in a capture, but no maps are estimated. Directions are those of the
# first photograph as displayed.

_GRID = 64  # points across the grid on which coverage is determined


def coverage_of_files(paths: Sequence[Path], fov: float | None = None) -> Inspection:
    """Register the photographs of a set and check its coverage.

    Args:
        paths: two or more; the first defines the frame, or a better one (register_in_any_order).
        fov: field of view along the long side, degrees; None for that of the metadata.

    Raises:
        MatcapError: one cannot be read, or the first has no flash.
    """
    if len(paths) < 2:
        raise MatcapError.at(
            paths[0],
            "one photograph cannot be compared with others",
            "give two or more of one sample",
        )
    photos = [load_photo(path, long_side=LONG_SIDE, fov=fov, noise=False) for path in paths]
    return coverage(register_in_any_order(photos))


def coverage(registration: Registration) -> Inspection:
    """Coverage findings of registered photographs."""
    views = registration.views
    lit = [view for view in views if view.flash]
    findings = [_belonging(registration)]
    if len(lit) > 1:
        findings.append(_sides(lit))
    findings.append(_places(lit))
    if len(views) > 1:
        findings.append(_cameras(views))
    findings.append(_common(views))
    if len(views) > 1:
        findings.append(_union(views))
    return Inspection(views[0].photo.name, tuple(findings))


def _belonging(registration: Registration) -> Finding:
    """Finding on which photographs could be registered."""
    views, out = registration.views, registration.left_out
    first, last, alone = views[0].photo.name, views[-1], len(views) < 2
    says = [f"{len(views)} photographs show the same sample."]
    if alone:
        strange = any(one.unmatched is not None for one in out)
        why = "shows the same sample as" if strange else "can be used with"
        says = [f"No other photograph {why} {first}."]
    if not last.flash:
        known = all(view.photo.exposure is not None for view in views)
        also = " and is subtracted from the others" if known else ""
        helps = f"its ambient light separates albedo from relief{also}"
        says.append(f"{last.photo.name} was taken without flash: {helps}.")
    says += [f"{one.name} does not belong: {one.why.rstrip('.')}." for one in out]
    says += [registration.frame] if registration.frame else []
    value = {"used": len(views), "left_out": [one.name for one in out]}
    if not out and not alone:
        return Finding("belong", value, Rating.GOOD, " ".join(says))
    remedy = "Leave it out" if len(out) == 1 else "Leave them out"
    remedy += (
        ", or photograph again: the same sample, sharp, with flash, with an overlap of two thirds."
    )
    rating = Rating.FAILED if alone else Rating.DOUBTFUL
    return Finding("belong", value, rating, " ".join(says), remedy)


def _sides(views: Sequence[RegisteredView]) -> Finding:
    """Finding on the sides from which flashes light the sample."""
    leaning = np.stack([view.camera.place[:2] / view.camera.place[2] for view in views])
    if views[0].photo.turned:
        # Turned upright, clockwise, the landscape's right side is the bottom, its top the right.
        leaning = np.stack([leaning[:, 1], -leaning[:, 0]], 1)
    (left, bottom), (right, top) = -leaning.min(0), leaning.max(0)
    offsets = {"left": left, "right": right, "top": top, "bottom": bottom}
    value = {side: round(float(offset), 3) for side, offset in offsets.items()}
    check = CHECKS["lit_from"]
    dark = [side for side, offset in offsets.items() if offset < check.limits[0]]
    if not dark:
        return check.rated(value, Rating.GOOD)
    return check.rated(
        value,
        Rating.NOT_JUDGED if len(dark) < len(offsets) else Rating.DOUBTFUL,
        sides=_listed(dark, "or"),
        moves=_listed(dark, "and"),
        each="" if len(dark) == 1 else ", once for each",
    )


def _places(views: Sequence[RegisteredView]) -> Finding:
    """Finding on cameras that coincide or are tilted too far."""
    place, steep = CHECKS["baseline"], CHECKS["steep"]
    near, nearest = [], math.inf
    for one, other in combinations(views, 2):
        baseline = np.linalg.norm(one.camera.place - other.camera.place)
        share = float(baseline / np.linalg.norm(one.camera.place))
        nearest = min(nearest, share)
        if share < place.limits[0]:
            near.append(place.says.format(one=one.photo.name, other=other.photo.name))
    tilted = [
        steep.says.format(name=view.photo.name, value=math.degrees(view.camera.tilt))
        for view in views
        if math.degrees(view.camera.tilt) > steep.limits[0]
    ]
    value = None if math.isinf(nearest) else round(nearest, 3)
    if not near and not tilted:
        return place.rated(value, Rating.GOOD)
    remedies = [*([place.remedy] if near else []), *([steep.remedy] if tilted else [])]
    return Finding("baseline", value, Rating.DOUBTFUL, " ".join(near + tilted), " ".join(remedies))


def _cameras(views: Sequence[RegisteredView]) -> Finding:
    """Finding on the standard deviations of the cameras."""
    check, worst = CHECKS["cameras"], max(views, key=lambda view: view.position_deviation)
    deviation = worst.position_deviation
    return check.rated(
        {view.photo.name: round(view.position_deviation, 5) for view in views[1:]},
        Rating.GOOD if deviation <= check.limits[0] else Rating.NOT_JUDGED,
        percent=100.0 * deviation,
        name=worst.photo.name,
    )


def _common(views: Sequence[RegisteredView]) -> Finding:
    """Finding on the share of the sample that two photographs or more show."""
    up = [view.photo.pixels.shape[0] / view.photo.pixels.shape[1] for view in views]
    points = grid_points(_GRID, round(_GRID * up[0]))
    each = (view.camera.shows(points, high, 90.0) for view, high in zip(views, up, strict=True))
    alone = float((np.stack(list(each)).sum(0) < 2).mean())
    check = CHECKS["overlap"]
    rating = Rating.GOOD if alone <= check.limits[0] else Rating.DOUBTFUL
    return check.rated(round(alone, 3), rating, shared=100.0 * (1.0 - alone))


def _union(views: Sequence[RegisteredView]) -> Finding:
    """Finding on the extent of the mosaic."""
    rows, columns = views[0].photo.pixels.shape[:2]
    mosaic = mosaic_of(views, (LONG_SIDE, round(LONG_SIDE * rows / columns)))
    value = round(mosaic.times, 2)
    if not mosaic.margins.any:
        says = "They show hardly more than the first one: --union makes the maps no larger."
    else:
        says = f"They show {value:g} times the first one's area: --union makes maps of all of it."
    return Finding("union", value, Rating.GOOD, says)


def _listed(words: Sequence[str], joint: str) -> str:
    """Enumerate words: commas, and `joint` before the last."""
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} {joint} {words[-1]}"
