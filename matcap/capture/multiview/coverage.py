"""Coverage checks of several photographs before capture: views, light directions, overlap.

Photographs are registered as in a capture, but no maps are estimated. Directions are those of the
first photograph as displayed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from matcap.capture.multiview.mosaic import mosaic_of, sees
from matcap.capture.registration.camera import grid_points
from matcap.capture.registration.covariance import UNCERTAIN
from matcap.capture.registration.keypoints import LONG_SIDE
from matcap.capture.registration.register import RegisteredView, Registration, register_in_any_order
from matcap.errors import MatcapError
from matcap.photo.checks import Finding, Rating
from matcap.photo.inspect import Inspection
from matcap.photo.load import load_photo

# Limits of the coverage checks.

# Least lateral offset of a camera, over its height, for the sample to be lit from that side; the
# remedy asks for a third.
_ASIDE = 0.15
# Baseline of two cameras, over their distance to the sample, below which they coincide.
SAME_PLACE = 0.08
_STEEP = 50.0  # largest tilt, degrees; beyond it few pixels cover the far side
_ALONE = 0.25  # largest share of the sample that only one photograph shows
_GRID = 64  # points across the grid on which coverage is determined


def coverage_of_files(paths: Sequence[Path], fov: float | None = None) -> Inspection:
    """Register the photographs of a set and check its coverage.

    Args:
        paths: two or more; the first defines the frame.
        fov: field of view along the long side, degrees; None for that of the metadata.

    Raises:
        MatcapError: one cannot be read, nothing can be fitted to the first, or it has no flash.
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
        says = [f"No other photograph shows the same sample as {first}."]
    if not last.flash:
        known = all(view.photo.exposure is not None for view in views)
        also = " and is subtracted from the others" if known else ""
        helps = f"its ambient light separates albedo from relief{also}"
        says.append(f"{last.photo.name} was taken without flash: {helps}.")
    says += [f"{one.name} does not belong: {one.why.rstrip('.')}." for one in out]
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
    dark = [side for side, offset in offsets.items() if offset < _ASIDE]
    if not dark:
        says = "The sample is lit from all four sides."
        return Finding("lit_from", value, Rating.GOOD, says)
    each = "" if len(dark) == 1 else ", once for each"
    return Finding(
        "lit_from",
        value,
        Rating.NOT_JUDGED if len(dark) < len(offsets) else Rating.DOUBTFUL,
        f"No photograph lights the sample from the {_listed(dark, 'or')}.",
        f"Photograph again with the phone moved by a third of its distance to the "
        f"{_listed(dark, 'and')}{each}.",
    )


def _places(views: Sequence[RegisteredView]) -> Finding:
    """Finding on cameras that coincide or are tilted too far."""
    same, nearest = [], math.inf
    for one, other in combinations(views, 2):
        baseline = np.linalg.norm(one.camera.place - other.camera.place)
        share = float(baseline / np.linalg.norm(one.camera.place))
        nearest = min(nearest, share)
        if share < SAME_PLACE:
            same.append(f"{one.photo.name} and {other.photo.name}")
    steep = [v for v in views if math.degrees(v.camera.tilt) > _STEEP]
    value = None if math.isinf(nearest) else round(nearest, 3)
    said = [f"{pair} were taken from nearly the same place." for pair in same]
    said += [
        f"{v.photo.name} was taken {math.degrees(v.camera.tilt):.0f} degrees off vertical."
        for v in steep
    ]
    if not said:
        return Finding("places", value, Rating.GOOD, "All were taken from different places.")
    moves = ["Move the phone by a third of its distance from one to the next."] if same else []
    if steep:
        moves.append("Stay within 45 degrees of vertical: the far side is covered by few pixels.")
    return Finding("places", value, Rating.DOUBTFUL, " ".join(said), " ".join(moves))


def _cameras(views: Sequence[RegisteredView]) -> Finding:
    """Finding on the standard deviations of the cameras."""
    worst = max(views, key=lambda view: view.position_deviation)
    deviation = worst.position_deviation
    value = {view.photo.name: round(view.position_deviation, 5) for view in views[1:]}
    says = f"Camera positions are uncertain by {100 * deviation:.2f} % of their distance"
    if deviation <= UNCERTAIN:
        return Finding("cameras", value, Rating.GOOD, f"{says}.")
    says += f" ({worst.photo.name}), because the flash's shading moves with the camera."
    remedy = "None needed: a capture models the shading, which at least halves this."
    return Finding("cameras", value, Rating.NOT_JUDGED, says, remedy)


def _common(views: Sequence[RegisteredView]) -> Finding:
    """Finding on the share of the sample that two photographs or more show."""
    up = [view.photo.pixels.shape[0] / view.photo.pixels.shape[1] for view in views]
    points = grid_points(_GRID, round(_GRID * up[0]))
    each = (sees(view.camera, points, high, 90.0) for view, high in zip(views, up, strict=True))
    seen = np.stack(list(each)).sum(0)
    alone = float((seen < 2).mean())
    says = f"{1.0 - alone:.0%} of the sample is in two photographs or more."
    if alone <= _ALONE:
        return Finding("common", round(alone, 3), Rating.GOOD, says)
    remedy = (
        "Aim the phone at the middle of the sample each time, so that all of it is in the picture."
    )
    return Finding("common", round(alone, 3), Rating.DOUBTFUL, says, remedy)


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
