"""Register photographs of one sample: a camera for each, and those that do not fit."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import combinations

import numpy as np

from matcap.capture.registration.camera import (
    DISTORTION,
    Adjusted,
    Pair,
    PosedCamera,
    adjust,
    camera_deviations,
)
from matcap.capture.registration.keypoints import (
    KeypointsBy,
    find_keypoints,
    is_periodic,
    losses_of_sharpness,
    match_photographs,
    shares_in_shadow,
    texture_correlations,
)
from matcap.errors import MatcapError
from matcap.flash.geometry import FlashSetup
from matcap.photo.inspect import hot_spot
from matcap.photo.photo import Photo

# Limits beyond which a photograph is left out.
MATCHES = 18  # least number of inliers; by chance there are 6 to 13 (docs/notes/several.md)
_REPROJECTION = 2.0  # largest median reprojection error, pixels
_STEEPEST = 65.0  # largest tilt of a camera, degrees
# Least correlation of fine texture with the first photograph after registration; it is 0 by
# chance, and 0.2 to 0.9 for the same sample.
_CORRELATION = 0.12
# Log loss of sharpness against the median from which a photograph is blurred; sharp ones vary by
# 0.14, a motion blur of a hundredth of the width is 0.28 and more.
_BLURRED = 0.22
# Prior of distortion, k1 and k2, if only one photograph has flash, as the displacement of
# its shading looks like it.
_STRAIGHT = (0.003, 0.001)
# Largest ratio of centre to border of a photograph without flash; larger values reject more
# flash photographs, smaller ones accept more ambient ones.
_FAINT = 1.15
_SHOWN = 1.3  # least ratio that proves a flash; without such a photograph none counts as ambient
# The first photograph defines the frame unless this share of it is in shadow, or what the others
# show of it is less than this share of what they show of another.
SHADED, _LEAST_OVERLAP = 0.1, 0.75
_CELLS = 32  # across the grid on which overlaps are determined


@dataclass(frozen=True)
class LeftOut:
    """A photograph that could not be registered."""

    name: str
    """Name of its file."""
    why: str
    """Reason, as the end of a sentence."""
    unmatched: int | None = None
    """Its index, if the reason is that few of its features match the first one's."""


@dataclass(frozen=True)
class RegisteredView:
    """A photograph and its camera."""

    photo: Photo
    """The photograph."""
    camera: PosedCamera
    """Its camera in the plane frame."""
    matches: int = 0
    """Number of inlier matches with the first photograph; 0 for the first."""
    correlation: float = 1.0
    """Correlation of fine texture with the first photograph."""
    flash: bool = True
    """Whether it is lit by flash, not by ambient light alone."""
    position_deviation: float = 0.0
    """Standard deviation of the camera's position relative to the first, over its distance."""
    misregistration: float = 0.0
    """Standard deviation of its registration to the first, plane units (camera.py)."""


@dataclass(frozen=True)
class Registration:
    """Result of registering photographs of one sample."""

    setup: FlashSetup
    """Setup of the first one, with field of view and tilt estimated from all."""
    views: tuple[RegisteredView, ...]
    """Registered photographs, the first one first; at most one without flash, last."""
    left_out: tuple[LeftOut, ...]
    """Photographs that could not be registered."""
    blurred: bool = False
    """Whether the first one is blurred compared with the others."""
    frame: str | None = None
    """Sentence on why another than the first given defines the frame, or had better; or None."""


def register_in_any_order(photos: Sequence[Photo]) -> Registration:
    """Register photographs; the first with flash defines the frame if it can, else the best.

    That is the one that most others match or, of those registered, a sharp one without shadow that
    the others overlap most. Copies of a picture count once. The initial tilt of the first camera is
    0; the result hardly depends on it (docs/notes/several.md).

    Args:
        photos: two or more, in any order.
    """
    photos, copies = _distinct(flash_first(photos))
    features = {id(photo): cache(partial(find_keypoints, photo)) for photo in photos}
    registered, reasons = register(photos, FlashSetup(fov=photos[0].fov), features), []
    for better_of in (partial(_most_matched, features=features), _best_shown):
        better, why = better_of(photos, registered)
        if better:
            order = [photos[better], *photos[:better], *photos[better + 1 :]]
            moved = register(order, FlashSetup(fov=order[0].fov), features)
            if len(moved.views) < len(registered.views) and not registered.blurred:
                continue
            why = f"The maps show what {order[0].name} shows, not {photos[0].name}: {why}."
            photos, registered = order, moved
        reasons += [why] if why else []
    registered = replace(registered, frame=" ".join(reasons) or None)
    return replace(registered, left_out=(*registered.left_out, *copies))


def _distinct(photos: Sequence[Photo]) -> tuple[list[Photo], list[LeftOut]]:
    """Photographs without copies of an earlier one's pixels, and these."""
    kept, copies = list[Photo](), list[LeftOut]()
    for photo in photos:
        twin = next((one for one in kept if np.array_equal(one.pixels, photo.pixels)), None)
        if twin is None:
            kept.append(photo)
        else:
            copies.append(LeftOut(photo.name, f"it is {twin.name} again, which counts once"))
    return kept, copies


def _most_matched(
    photos: Sequence[Photo], registered: Registration, features: Mapping[int, KeypointsBy]
) -> tuple[int, str]:
    """Index of the photograph with flash that most others match, and why; 0 if the first is it.

    Two that match the first count as matching each other until one of them is the best.
    """
    unmatched = {one.unmatched for one in registered.left_out if one.unmatched is not None}
    dark, numbers = without_flash(photos), range(len(photos))

    @cache
    def matches(one: int, other: int) -> bool:
        if not min(one, other):
            return max(one, other) not in unmatched
        places, _, _ = match_photographs(*(features[id(photos[n])] for n in (one, other)))
        return places.shape[1] >= MATCHES

    near = np.zeros((len(photos),) * 2, bool)
    for one, other in combinations(numbers, 2):
        known = one and not {one, other} & unmatched
        near[one, other] = near[other, one] = known or matches(one, other)
    matching = near.sum(1)
    matching[list(dark)] = 0
    best, first = int(matching.argmax()), int(matching[0])
    count = sum(matches(*sorted((best, other))) for other in numbers if other != best)
    if not best or count <= first:
        return 0, ""
    return (
        best,
        f"{count} {'other matches' if count == 1 else 'others match'} it, {first} the first",
    )


def _best_shown(photos: Sequence[Photo], registered: Registration) -> tuple[int, str]:
    """Index of the photograph that had better define the frame, and why; 0 if it is the first.

    Why is also said where the first is blurred or in shadow, and no other is better.
    """
    views = [view for view in registered.views if view.flash]
    if len(views) < 2:
        return 0, ""
    shaded = np.array(shares_in_shadow([(view.photo, view.camera) for view in views]))
    bad = shaded > SHADED
    bad[0] |= registered.blurred
    overlap = np.array([_overlap(view, views) for view in views])
    best = int(np.argmax(overlap - bad))
    place = next(n for n, photo in enumerate(photos) if photo is views[best].photo)
    if bad[0]:
        why = (
            "{} is blurred"
            if registered.blurred
            else f"{100 * shaded[0]:.0f} % of {{}} is in shadow"
        )
        if bad[best]:
            return 0, why.format(views[0].photo.name) + "."
        return place, why.format("that")
    if overlap[0] > _LEAST_OVERLAP * overlap[best]:
        return 0, ""
    first, other = (f"{100 * overlap[number]:.0f} %" for number in (0, best))
    return place, f"the others show {other} of it, and {first} of the first"


def _overlap(view: RegisteredView, views: Sequence[RegisteredView]) -> float:
    """Mean share of what a photograph shows that each other one shows too."""
    up = view.photo.pixels.shape[0] / view.photo.pixels.shape[1]
    image = np.stack(np.meshgrid(*((np.arange(_CELLS) + 0.5) / _CELLS * 2.0 - 1.0,) * 2))
    points = view.camera.on_plane(image * np.array([1.0, up])[:, None, None])
    shown = []
    for other in views:
        if other is not view:
            rows, columns, _ = other.photo.pixels.shape
            shown.append(other.camera.shows(points, rows / columns, 90.0))
    return float(np.mean(shown))


def register(
    photos: Sequence[Photo], setup: FlashSetup, features: Mapping[int, KeypointsBy] | None = None
) -> Registration:
    """Estimate the camera of every photograph in the first one's plane frame.

    Args:
        photos: two or more; any exposure, white balance and orientation.
        setup: of the first, by its coarse fit.
        features: of each photograph by its id(); None to find them.

    Raises:
        MatcapError: the first was taken without the flash that the others show.
    """
    dark = without_flash(photos)
    if 0 in dark:
        raise MatcapError.at(
            photos[0].name,
            f"it was photographed without the flash ({dark[0]})",
            "name a photograph with flash first, from the middle",
        )
    if features is None:
        features = {id(photo): cache(partial(find_keypoints, photo)) for photo in photos}
    pairs, left_out = _matched([features[id(photo)] for photo in photos], photos)
    few = set(left_out)
    while True:
        # Fit again without the worst one, as it affects the others.
        fitted = _Fitted.of(photos, setup, pairs, dark)
        worst = fitted.worst(photos, dark)
        if worst is None:
            break
        index, left_out[index] = worst
        del pairs[index]
    views = fitted.views(photos, pairs, dark)
    unlit = sorted((n for n in views if n in dark), key=lambda n: -views[n].matches)
    for index in unlit[1:]:
        left_out[index] = f"{photos[unlit[0]].name} shows the ambient light better"
    shown = [view for view in views.values() if view.flash] + [views[n] for n in unlit[:1]]
    named = tuple(
        LeftOut(
            photos[index].name,
            f"{dark[index]}; {why}" if index in dark else why,
            index if index in few else None,
        )
        for index, why in sorted(left_out.items())
    )
    blurred = fitted.losses[0] > _BLURRED
    return Registration(fitted.adjusted.first, tuple(shown), named, blurred)


def _matched(
    features: Sequence[KeypointsBy], photos: Sequence[Photo]
) -> tuple[dict[int, Pair], dict[int, str]]:
    """Matches of photographs with the first by index; reasons of those that have too few."""
    pairs, left_out = dict[int, Pair](), dict[int, str]()
    for index, photo in enumerate(photos[1:], 1):
        first, second, pixel = match_photographs(features[0], features[index])
        if first.shape[1] >= MATCHES:
            ratio = FlashSetup(fov=photo.fov).distance / FlashSetup(fov=photos[0].fov).distance
            pairs[index] = Pair(first, second, pixel, ratio)
            continue
        left_out[index] = (
            f"only {first.shape[1]} of its features match {photos[0].name}, "
            f"at least {MATCHES} are needed"
        )
        if is_periodic(photos[0]):
            left_out[index] += "; its pattern repeats: show a border or a mark in all photographs"
    return pairs, left_out


@dataclass(frozen=True)
class _Fitted:
    """Bundle adjustment of some photographs, and how well they fit; by index, the first one's 0."""

    adjusted: Adjusted
    errors: Mapping[int, float]
    """Median reprojection error of each but the first, pixels."""
    cameras: Mapping[int, PosedCamera]
    correlations: Mapping[int, float]
    """Correlation of fine texture of each but the first with it."""
    losses: Mapping[int, float]
    """Log loss of sharpness of each with flash."""

    @staticmethod
    def of(
        photos: Sequence[Photo], setup: FlashSetup, pairs: Mapping[int, Pair], dark: Container[int]
    ) -> _Fitted:
        """Fit the cameras of matched photographs."""
        known = photos[0].fov_source != "assumed"
        distortion = _STRAIGHT if all(index in dark for index in pairs) else DISTORTION
        adjusted = adjust(setup, list(pairs.values()), known=known, distortion=distortion)
        cameras = dict(zip([0, *pairs], adjusted.cameras, strict=True))
        seen = {n: (photos[n], camera) for n, camera in cameras.items()}
        lit = [index for index in cameras if index not in dark]
        losses = losses_of_sharpness([photos[n] for n in lit], [cameras[n] for n in lit])
        return _Fitted(
            adjusted,
            dict(zip(pairs, adjusted.reprojection_errors, strict=True)),
            cameras,
            dict(zip(pairs, texture_correlations(list(seen.values())), strict=True)),
            dict(zip(lit, losses, strict=True)),
        )

    def worst(self, photos: Sequence[Photo], dark: Container[int]) -> tuple[int, str] | None:
        """(index, reason) of the photograph to leave out, if any.

        That with the least plausible camera or, if all are plausible, the most blurred.
        """
        wrong = []
        for index, error in self.errors.items():
            camera = self.cameras[index]
            tilt, correlation = math.degrees(camera.tilt), self.correlations[index]
            if not np.isfinite(camera.place).all() or camera.place[2] <= 0.05:
                wrong.append((math.inf, index, "its matches fit no camera above a flat sample"))
            elif error > _REPROJECTION:
                why = f"its matches are {error:.1f} pixels off: the sample moved or is not flat"
                wrong.append((error / _REPROJECTION, index, why))
            elif tilt > _STEEPEST:
                why = f"its camera is {tilt:.0f} degrees off vertical"
                wrong.append((1.0, index, f"{why}, at most {_STEEPEST:.0f} are allowed"))
            elif correlation < _CORRELATION:
                why = f"it differs from {photos[0].name} at the same place, or is blurred"
                wrong.append((1.0 + _CORRELATION - correlation, index, why))
        if wrong:
            return max(wrong)[1:]
        loss, index = max(((loss, n) for n, loss in self.losses.items() if n), default=(0.0, 0))
        why = f"it is blurred: its finest detail is {100 * math.exp(-loss):.0f} % of the others'"
        return (index, why) if loss > _BLURRED else None

    def views(
        self, photos: Sequence[Photo], pairs: Mapping[int, Pair], dark: Container[int]
    ) -> dict[int, RegisteredView]:
        """The photographs with their cameras, by index."""
        views = {0: RegisteredView(photos[0], self.cameras[0])}
        fitted = camera_deviations(self.adjusted, list(pairs.values()))
        deviations = zip(pairs, fitted.positions, fitted.misregistration, strict=True)
        for index, position, misregistration in deviations:
            views[index] = RegisteredView(
                photos[index],
                self.cameras[index],
                matches=pairs[index].first.shape[1],
                correlation=self.correlations[index],
                flash=index not in dark,
                position_deviation=float(position),
                misregistration=float(misregistration),
            )
        return views


def flash_first(photos: Sequence[Photo]) -> list[Photo]:
    """Move photographs without flash to the end, otherwise keeping the order."""
    dark = without_flash(photos)
    lit = [photo for number, photo in enumerate(photos) if number not in dark]
    return lit + [photos[number] for number in dark]


def without_flash(photos: Sequence[Photo]) -> dict[int, str]:
    """Indices of photographs taken without flash, each with its reason (end of a sentence).

    By metadata, or without them by the falloff from the mirror point that a flash has. Empty if no
    photograph seems to have flash, as EXIF does not record external flashes and ring lights.
    """
    falloff = [hot_spot(photo)[1] for photo in photos]
    lit = [
        photo.flash_fired is True or (photo.flash_fired is None and bright >= _SHOWN)
        for photo, bright in zip(photos, falloff, strict=True)
    ]
    if not any(lit):
        return {}
    reasons = {}
    for number, (photo, bright) in enumerate(zip(photos, falloff, strict=True)):
        if photo.flash_fired is False:
            reasons[number] = "the flash did not fire by its metadata"
        elif photo.flash_fired is None and bright < _FAINT:
            reasons[number] = (
                "it shows no flash: its middle is hardly brighter than its border "
                f"({bright:.2f} times)"
            )
    return reasons
