"""Register photographs of one sample: a camera for each; unrelated ones are named."""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.flash.geometry import FlashSetup
from matcap.flash.registration.adjust import Adjusted, AdjustSettings, Pair, adjust
from matcap.flash.registration.ambient import flash_first, without_flash
from matcap.flash.registration.camera import PosedCamera
from matcap.flash.registration.doubt import doubts
from matcap.flash.registration.grid import grid_points, to_pixels
from matcap.flash.registration.keypoints import KeypointFinder
from matcap.flash.registration.period import repeats_itself
from matcap.flash.registration.sharp import SHARP, blurring
from matcap.photo.photo import DEFAULT_FOV, Photo


@dataclass(frozen=True)
class RegisterSettings:
    """When a photograph belongs to a piece; stricter leaves more out."""

    matches: int = 18
    """Least number that agree; by chance 6 to 13 do (docs/notes/several.md)."""
    off: float = 2.0
    """Pixels that its matches lie beside each other, at most (median)."""
    steepest: float = 65.0
    """Degrees that a camera may lean."""
    alike: float = 0.12
    """Least correlation of what both show, fine texture over even contrast, at the found place; by
    chance it is 0, of the same piece 0.2 to 0.9."""
    compared: int = 384
    """Texels across that are compared."""
    shifted: int = 5
    """Texels to all sides where the correlation must be lower."""
    straight: AdjustSettings = AdjustSettings(bent=(0.003, 0.001))
    """Priors where only one photograph has flash: its features lie beside those of the others as
    if a lens distorted them, for shading goes with the light."""


@dataclass(frozen=True)
class LeftOut:
    """A photograph that is not used."""

    name: str
    """Its file's."""
    why: str
    """The rest of a sentence."""


@dataclass(frozen=True)
class RegisteredView:
    """A photograph and its camera."""

    photo: Photo
    """The photograph."""
    camera: PosedCamera
    """In the plane's frame."""
    matches: int = 0
    """With the first photograph that agree; 0 of the first itself."""
    off: float = 0.0
    """Pixels that they lie beside each other (median)."""
    alike: float = 1.0
    """Correlation with the first photograph."""
    flash: bool = True
    """Whether its own flash lit it; else the room did."""
    doubt: float = 0.0
    """What its camera's place beside the first one's may be off by, over its distance, one
    deviation (doubt.py)."""
    astray: float = 0.0
    """Plane units that it may lie beside the first by, one deviation, likewise."""


@dataclass(frozen=True)
class Registration:
    """Photographs of one piece."""

    setup: FlashSetup
    """Of the first one, field of view and tilt estimated from all."""
    views: tuple[RegisteredView, ...]
    """Those that belong, the first one first; one without flash at most, last."""
    left_out: tuple[LeftOut, ...]
    """Those that do not."""
    blurred: bool = False
    """Whether the first one is, beside the others."""


def register_in_any_order(photos: Sequence[Photo]) -> Registration:
    """Register photographs; the first with flash gives the frame, or the next if that is blurred.

    The first camera begins above the plane: where it begins makes no difference
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


def register(
    photos: Sequence[Photo], setup: FlashSetup, settings: RegisterSettings = RegisterSettings()
) -> Registration:
    """Estimate the camera of every photograph in the first one's plane frame.

    Args:
        photos: two or more; any exposure, white balance and orientation.
        setup: of the first, by its coarse fit.
        settings: see RegisterSettings.

    Raises:
        MatcapError: the first was taken without the flash that the others show.
    """
    finder = KeypointFinder()
    pairs, left_out = dict[int, Pair](), dict[int, str]()
    dark = without_flash(photos)
    if 0 in dark:
        raise MatcapError(
            f"it was photographed without the flash ({dark[0]})",
            where=photos[0].name,
            remedy="name a photograph with flash first, from the middle",
        )
    for index in range(1, len(photos)):
        first, second, pixel = finder.matched(photos[0], photos[index])
        if first.shape[1] < settings.matches:
            why = (
                f"only {first.shape[1]} of its features match {photos[0].name}, "
                f"at least {settings.matches} are needed"
            )
            if repeats_itself(photos[0]):
                why += "; its pattern repeats: let all photographs show a border or a mark"
            left_out[index] = why
            continue
        ratio = FlashSetup(fov=photos[index].fov).distance / FlashSetup(fov=photos[0].fov).distance
        pairs[index] = Pair(first, second, pixel, ratio)
    known = photos[0].fov_source != "assumed" and photos[0].fov != DEFAULT_FOV
    blurred = False
    while True:
        priors = settings.straight if all(index in dark for index in pairs) else AdjustSettings()
        adjusted = adjust(setup, list(pairs.values()), known=known, settings=priors)
        wrong = _wrong(photos, dict(zip(pairs, range(len(pairs)), strict=True)), adjusted, settings)
        if not wrong:
            blurred, wrong = _blurred(photos, list(pairs), dark, adjusted)
        if not wrong:
            break
        # The worst goes first: it may have misled the others.
        index, why = wrong[0]
        left_out[index] = why
        del pairs[index]
    views, worse = _views(photos, pairs, dark, adjusted, settings)
    left_out |= worse
    names = tuple(
        LeftOut(photos[index].name, "; ".join([*([dark[index]] if index in dark else []), why]))
        for index, why in sorted(left_out.items())
    )
    return Registration(adjusted.first, views, names, blurred)


def _views(
    photos: Sequence[Photo],
    pairs: dict[int, Pair],
    dark: Container[int],
    adjusted: Adjusted,
    settings: RegisterSettings,
) -> tuple[tuple[RegisteredView, ...], dict[int, str]]:
    """Photographs with flash, then the best without, and why others without are not used."""
    lit, unlit = [RegisteredView(photos[0], adjusted.cameras[0])], dict[int, RegisteredView]()
    unsure = doubts(adjusted, list(pairs.values()))
    for number, (index, pair) in enumerate(pairs.items()):
        view = RegisteredView(photos[index], adjusted.cameras[number + 1])
        view = replace(
            view,
            matches=pair.first.shape[1],
            off=adjusted.off[number],
            alike=likeness(lit[0], view, settings),
            flash=index not in dark,
            doubt=float(unsure.places[number]),
            astray=float(unsure.astray[number]),
        )
        if view.flash:
            lit.append(view)
        else:
            unlit[index] = view
    best = sorted(unlit, key=lambda index: -unlit[index].matches)
    better = f"{unlit[best[0]].photo.name} shows the ambient light better" if best else ""
    worse = {index: better for index in best[1:]}
    return (*lit, *(unlit[index] for index in best[:1])), worse


def _blurred(
    photos: Sequence[Photo], others: Sequence[int], dark: Container[int], adjusted: Adjusted
) -> tuple[bool, list[tuple[int, str]]]:
    """Whether the first is blurred, and which others are, the worst first, each with why."""
    lit = [(0, 0), *((index, n) for n, index in enumerate(others, 1) if index not in dark)]
    blur = blurring([photos[index] for index, _ in lit], [adjusted.cameras[n] for _, n in lit])
    ranked = sorted(zip(blur, lit, strict=True), reverse=True)
    return blur[0] > SHARP.blurred, [
        (index, f"it is blurred: it shows {math.exp(-amount):.0%} of the others' finest detail")
        for amount, (index, _) in ranked
        if index and amount > SHARP.blurred
    ]


def _wrong(
    photos: Sequence[Photo], numbers: dict[int, int], adjusted: Adjusted, settings: RegisterSettings
) -> list[tuple[int, str]]:
    """Photographs with an implausible camera, the worst first, each with its reason."""
    wrong = []
    first = RegisteredView(photos[0], adjusted.cameras[0])
    for index, number in numbers.items():
        camera, off = adjusted.cameras[number + 1], adjusted.off[number]
        if not np.isfinite(camera.place).all() or camera.place[2] <= 0.05:
            wrong.append((math.inf, index, "its matches fit no camera position above a flat piece"))
        elif off > settings.off:
            why = f"its matches are {off:.1f} pixels off: the piece moved or is not flat"
            wrong.append((off / settings.off, index, why))
        elif math.degrees(camera.tilt) > settings.steepest:
            why = (
                f"its camera is {math.degrees(camera.tilt):.0f} degrees off vertical, at most "
                f"{settings.steepest:.0f} are allowed"
            )
            wrong.append((1.0, index, why))
        else:
            alike = likeness(first, RegisteredView(photos[index], camera), settings)
            if alike < settings.alike:
                why = f"it differs from {photos[0].name} at the same place, or is blurred"
                wrong.append((1.0 + settings.alike - alike, index, why))
    return [(index, why) for _, index, why in sorted(wrong, reverse=True)]


def likeness(first: RegisteredView, second: RegisteredView, settings: RegisterSettings) -> float:
    """Correlation of the fine texture of two registered photographs over their overlap.

    In [-1, 1]; -1 without overlap, or where a shift by a few texels correlates better.
    """
    across = settings.compared
    down = round(across * first.photo.pixels.shape[0] / first.photo.pixels.shape[1])
    seen = [_texture(view, across, down) for view in (first, second)]
    both = seen[0][1] & seen[1][1]
    if both.mean() < 0.05:
        return -1.0

    def correlation(x: int, y: int) -> float:
        moved = np.roll(seen[1][0], (y, x), (0, 1))
        a, b = seen[0][0][both], moved[both]
        return float((a * b).mean() / max(float(np.sqrt((a * a).mean() * (b * b).mean())), 1e-9))

    here = correlation(0, 0)
    far = settings.shifted
    shifted = max(correlation(x, y) for x, y in ((far, 0), (-far, 0), (0, far), (0, -far)))
    return here if here > shifted else -1.0


def _texture(
    view: RegisteredView, across: int, down: int
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(H, W) high-passed log radiance over its local contrast on the plane's grid, and its mask."""
    rows, columns = view.photo.pixels.shape[:2]
    size = (across, round(across * rows / columns))
    grey = cv2.resize(view.photo.pixels.mean(2), size, interpolation=cv2.INTER_AREA)
    log = np.log(np.maximum(grey, 1e-5)).astype(np.float32)
    image = view.camera.sees(grid_points(across, down))
    x, y = to_pixels(image, size[0], size[1])
    inside = (x > 1) & (x < size[0] - 2) & (y > 1) & (y < size[1] - 2)
    there = cv2.remap(log, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
    fine = cv2.GaussianBlur(there, (0, 0), 1.0) - cv2.GaussianBlur(there, (0, 0), 6.0)
    around = np.sqrt(cv2.GaussianBlur(fine * fine, (0, 0), 12.0)) + 1e-4
    return (fine / around).astype(np.float32), np.asarray(inside)
