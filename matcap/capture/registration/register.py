"""Register photographs of one sample: a camera for each, and those that do not fit."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.capture.registration.adjust import DISTORTION, Adjusted, Pair, adjust
from matcap.capture.registration.camera import PosedCamera, log_on_grid
from matcap.capture.registration.covariance import camera_deviations
from matcap.capture.registration.keypoints import find_keypoints, is_periodic, match_photographs
from matcap.capture.registration.sharpness import BLURRED, losses_of_sharpness
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
_COMPARED = 384  # texels across the grid of the correlation
_SHIFTED = 5  # shift in texels at which the correlation must be lower
# Prior of distortion, k1 and k2, if only one photograph has flash, as the displacement of
# its shading looks like it.
_STRAIGHT = (0.003, 0.001)
# Largest ratio of centre to border of a photograph without flash; larger values reject more
# flash photographs, smaller ones accept more ambient ones.
_FAINT = 1.15
_SHOWN = 1.3  # least ratio that proves a flash; without such a photograph none counts as ambient


@dataclass(frozen=True)
class LeftOut:
    """A photograph that could not be registered."""

    name: str
    """Name of its file."""
    why: str
    """Reason, as the end of a sentence."""


@dataclass(frozen=True)
class RegisteredView:
    """A photograph and its camera."""

    photo: Photo
    """The photograph."""
    camera: PosedCamera
    """Its camera in the plane frame."""
    matches: int = 0
    """Number of inlier matches with the first photograph; 0 for the first."""
    reprojection_error: float = 0.0
    """Median reprojection error of these, pixels."""
    correlation: float = 1.0
    """Correlation of fine texture with the first photograph."""
    flash: bool = True
    """Whether it is lit by flash, not by ambient light alone."""
    position_deviation: float = 0.0
    """Standard deviation of the camera's position relative to the first, over its distance
    (covariance.py)."""
    misregistration: float = 0.0
    """Standard deviation of its registration to the first, plane units (covariance.py)."""


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


def register_in_any_order(photos: Sequence[Photo]) -> Registration:
    """Register photographs; the first with flash defines the frame, or the next if that is blurred.

    The initial tilt of the first camera is 0; the result hardly depends on it
    (docs/notes/several.md).

    Args:
        photos: two or more, in any order.
    """
    photos = flash_first(photos)
    registration = register(photos, FlashSetup(fov=photos[0].fov))
    if registration.blurred and len(registration.views) > 2:
        photos = flash_first([*photos[1:], photos[0]])
        registration = register(photos, FlashSetup(fov=photos[0].fov))
    return registration


def register(photos: Sequence[Photo], setup: FlashSetup) -> Registration:
    """Estimate the camera of every photograph in the first one's plane frame.

    Args:
        photos: two or more; any exposure, white balance and orientation.
        setup: of the first, by its coarse fit.

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
    pairs, left_out = _matched(photos)
    adjusted, blurred, wrong = _adjusted(photos, setup, pairs, dark)
    while wrong:
        # Remove the worst and fit again, as it affects the others.
        index, why = wrong[0]
        left_out[index] = why
        del pairs[index]
        adjusted, blurred, wrong = _adjusted(photos, setup, pairs, dark)
    views, worse = _views(photos, pairs, dark, adjusted)
    left_out |= worse
    named = tuple(
        LeftOut(photos[index].name, f"{dark[index]}; {why}" if index in dark else why)
        for index, why in sorted(left_out.items())
    )
    return Registration(adjusted.first, views, named, blurred)


def _matched(photos: Sequence[Photo]) -> tuple[dict[int, Pair], dict[int, str]]:
    """Matches of photographs with the first by index; reasons of those that have too few."""
    keypoints_of_first = cache(partial(find_keypoints, photos[0]))
    pairs, left_out = dict[int, Pair](), dict[int, str]()
    for index, photo in enumerate(photos[1:], 1):
        first, second, pixel = match_photographs(keypoints_of_first, photo)
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


def _adjusted(
    photos: Sequence[Photo], setup: FlashSetup, pairs: Mapping[int, Pair], dark: Container[int]
) -> tuple[Adjusted, bool, list[tuple[int, str]]]:
    """Bundle adjustment, whether the first is blurred, and photographs to leave out.

    The latter are (index, reason), the worst first: with an implausible camera or, if there are
    none, blurred.
    """
    known = photos[0].fov_source != "assumed"
    distortion = _STRAIGHT if all(index in dark for index in pairs) else DISTORTION
    adjusted = adjust(setup, list(pairs.values()), known=known, distortion=distortion)
    cameras = dict(zip([0, *pairs], adjusted.cameras, strict=True))
    wrong = _wrong(photos, cameras, dict(zip(pairs, adjusted.reprojection_errors, strict=True)))
    if wrong:
        return adjusted, False, wrong
    lit = {index: camera for index, camera in cameras.items() if index not in dark}
    return adjusted, *_blurred(photos, lit)


def _views(
    photos: Sequence[Photo],
    pairs: dict[int, Pair],
    dark: Container[int],
    adjusted: Adjusted,
) -> tuple[tuple[RegisteredView, ...], dict[int, str]]:
    """Views with flash, then the best one without; and reasons by index for the others without."""
    first = adjusted.cameras[0]
    views = {0: RegisteredView(photos[0], first)}
    deviations = camera_deviations(adjusted, list(pairs.values()))
    for number, (index, pair) in enumerate(pairs.items()):
        camera = adjusted.cameras[number + 1]
        views[index] = RegisteredView(
            photos[index],
            camera,
            matches=pair.first.shape[1],
            reprojection_error=adjusted.reprojection_errors[number],
            correlation=texture_correlation(photos[0], first, photos[index], camera),
            flash=index not in dark,
            position_deviation=float(deviations.positions[number]),
            misregistration=float(deviations.misregistration[number]),
        )
    unlit = sorted((n for n in views if n in dark), key=lambda n: -views[n].matches)
    lit = (view for view in views.values() if view.flash)
    worse = {
        index: f"{photos[unlit[0]].name} shows the ambient light better" for index in unlit[1:]
    }
    return (*lit, *(views[index] for index in unlit[:1])), worse


def _blurred(
    photos: Sequence[Photo], cameras: Mapping[int, PosedCamera]
) -> tuple[bool, list[tuple[int, str]]]:
    """Whether the first is blurred; and (index, reason) of blurred others, the worst first.

    `cameras` are those of the photographs with flash, by index.
    """
    blur = losses_of_sharpness([photos[index] for index in cameras], list(cameras.values()))
    ranked = sorted(zip(blur, cameras, strict=True), reverse=True)
    return blur[0] > BLURRED, [
        (index, f"it is blurred: its finest detail is {math.exp(-amount):.0%} of the others'")
        for amount, index in ranked
        if index and amount > BLURRED
    ]


def _wrong(
    photos: Sequence[Photo], cameras: Mapping[int, PosedCamera], errors: Mapping[int, float]
) -> list[tuple[int, str]]:
    """(index, reason) of photographs with an implausible camera, the worst first.

    Args:
        photos: all.
        cameras: by index, the first one's included.
        errors: median reprojection errors by index, pixels.
    """
    wrong = []
    for index, error in errors.items():
        camera = cameras[index]
        if not np.isfinite(camera.place).all() or camera.place[2] <= 0.05:
            wrong.append((math.inf, index, "its matches fit no camera above a flat sample"))
        elif error > _REPROJECTION:
            why = f"its matches are {error:.1f} pixels off: the sample moved or is not flat"
            wrong.append((error / _REPROJECTION, index, why))
        elif math.degrees(camera.tilt) > _STEEPEST:
            why = (
                f"its camera is {math.degrees(camera.tilt):.0f} degrees off vertical, at most "
                f"{_STEEPEST:.0f} are allowed"
            )
            wrong.append((1.0, index, why))
        else:
            correlation = texture_correlation(photos[0], cameras[0], photos[index], camera)
            if correlation < _CORRELATION:
                why = f"it differs from {photos[0].name} at the same place, or is blurred"
                wrong.append((1.0 + _CORRELATION - correlation, index, why))
    return [(index, why) for _, index, why in sorted(wrong, reverse=True)]


def texture_correlation(
    first: Photo, first_camera: PosedCamera, second: Photo, second_camera: PosedCamera
) -> float:
    """Correlation of the fine texture of two registered photographs over their overlap.

    In [-1, 1]; -1 without overlap, or if a shift by a few texels correlates better.
    """
    down = round(_COMPARED * first.pixels.shape[0] / first.pixels.shape[1])
    texture, inside = _texture(first, first_camera, down)
    other, other_inside = _texture(second, second_camera, down)
    both = inside & other_inside
    if both.mean() < 0.05:
        return -1.0

    def correlation(x: int, y: int) -> float:
        a, b = texture[both], np.roll(other, (y, x), (0, 1))[both]
        return float((a * b).mean() / max(float(np.sqrt((a * a).mean() * (b * b).mean())), 1e-9))

    far = _SHIFTED
    shifted = max(correlation(x, y) for x, y in ((far, 0), (-far, 0), (0, far), (0, -far)))
    aligned = correlation(0, 0)
    return aligned if aligned > shifted else -1.0


def _texture(
    photo: Photo, camera: PosedCamera, down: int
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(down, _COMPARED) high-passed log radiance over its local contrast on the plane, its mask."""
    size = (_COMPARED, down)
    log, inside = log_on_grid(photo, camera, size, _COMPARED, 1e-5, cv2.INTER_LINEAR)
    fine = cv2.GaussianBlur(log, (0, 0), 1.0) - cv2.GaussianBlur(log, (0, 0), 6.0)
    contrast = np.sqrt(cv2.GaussianBlur(fine * fine, (0, 0), 12.0)) + 1e-4
    return (fine / contrast).astype(np.float32), inside


def flash_first(photos: Sequence[Photo]) -> list[Photo]:
    """Move photographs without flash to the end, otherwise keeping the order."""
    dark = without_flash(photos)
    lit = [photo for number, photo in enumerate(photos) if number not in dark]
    return lit + [photos[number] for number in dark]


def without_flash(photos: Sequence[Photo]) -> dict[int, str]:
    """Indices of photographs taken without flash, each with its reason (end of a sentence).

    By metadata, or without them by the falloff from the mirror point that a flash has. Empty if no
    photograph seems to have flash, as EXIF does not record external flashes and ring lights.

    Args:
        photos: of one sample.
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
