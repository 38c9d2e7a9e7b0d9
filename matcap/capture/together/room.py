"""Ambient light: subtracted from flash photographs, and a photograph by it alone as a measurement.

A photograph without the flash shows albedo under light that hardly changes over the piece. Where
exposures are known what it shows is what the flash photographs have too much ([aittala2015]
takes two such photographs); and since what the room adds changes slowly and leans one way, what
changes fast in it is albedo, whatever the flash made of that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.capture.piece.smooth import smoothed
from matcap.flash.registration.grid import to_pixels
from matcap.flash.registration.register import RegisteredView, Registration
from matcap.photo.photo import FULL, Photo

Picture = NDArray[np.float32]


@dataclass(frozen=True)
class RoomSettings:
    """How the room's light is dealt with; docs/notes/several.md."""

    noise: float = 0.08
    """Of log radiance, what the model of a room's light is off by."""
    slow: float = 0.08
    """Deviation of what the room lights otherwise from place to place, as a share of the long
    side."""
    steepest: float = 1.0
    """Of a window's lean: log radiance by slope."""
    faintest: float = 0.05
    """Share of a pixel's light that stays when the room's is taken off."""
    bound: float = 0.005
    """Share of pixels that may be darker than the room alone would make them."""


ROOM = RoomSettings()


@dataclass(frozen=True)
class RoomIncidence:
    """A room's light that arrives at a relief: even, and mirrored by F0 from all around."""

    irradiance: Tensor

    def diffuse(self, albedo: Tensor) -> Tensor:
        """Radiance (3, h, w) of diffuse albedo (3, h, w)."""
        return albedo * self.irradiance

    def specular(self, specular: Tensor, roughness: Tensor) -> Tensor:
        """Radiance (3, h, w) mirrored by F0 (1, h, w); surroundings look the same at any gloss."""
        return (specular + 0.0 * roughness) * self.irradiance

    def radiance(self, diffuse: Tensor, specular: Tensor, roughness: Tensor) -> Tensor:
        """Radiance (3, h, w) of both."""
        return self.diffuse(diffuse) + self.specular(specular, roughness)


@dataclass(frozen=True)
class RoomLight:
    """Light of a room, the same all over the piece but for the side it comes from."""

    lean: tuple[float, float] = (0.0, 0.0)
    """(2,) what log radiance gains with slope, for light from one side."""
    strength: Tensor | None = None
    """(3, 1, 1) of all of it; None for 1."""

    def onto(self, normal: Tensor) -> RoomIncidence:
        """What arrives at a relief of unit normals (3, h, w)."""
        slopes = -normal[:2] / normal[2:].clamp_min(1e-3)
        leant = self.lean[0] * slopes[:1] + self.lean[1] * slopes[1:]
        lit = leant.clamp(-2.0, 2.0).exp()
        return RoomIncidence(lit if self.strength is None else lit * self.strength)


def evenly_lit(
    log: Tensor, seen: Tensor, rendered: Tensor, slopes: Tensor
) -> tuple[Tensor, tuple[float, float]]:
    """A photograph by the room's light less what of it is slow, and how much its light leans.

    Args:
        log, seen: (3, h, w) its log radiance, and where it shows it.
        rendered: (3, h, w) log radiance of the maps so far under light from everywhere.
        slopes: (2, h, w) of them.
    """
    off = (log - rendered).numpy()
    mask = seen.float().numpy()
    deviation = ROOM.slow * max(log.shape[1:])

    def fast(plane: Picture, weight: Picture) -> Picture:
        whole = smoothed(weight, deviation)
        left = plane - smoothed(plane * weight, deviation) / np.maximum(whole, np.float32(1e-3))
        return np.asarray(left, np.float32)

    left = np.stack([fast(each, weight) for each, weight in zip(off, mask, strict=True)])
    leaning = np.stack([fast(each, mask.mean(0)) for each in slopes.numpy()])
    lean = _leaning(left.mean(0), leaning, mask.min(0) > 0.0)
    # What the lean explains is no error of the photograph's: it stays in it.
    return rendered + torch.from_numpy(left), lean


def _leaning(left: Picture, slopes: Picture, seen: NDArray[np.bool_]) -> tuple[float, float]:
    """What log radiance (h, w) gains with slopes (2, h, w), robustly."""
    if seen.sum() < 100:
        return (0.0, 0.0)
    x, y = slopes[:, seen].astype(np.float64), left[seen].astype(np.float64)
    weight: NDArray[np.float64] = np.ones_like(y)
    lean = np.zeros(2)
    for _ in range(4):
        normal = (x * weight) @ x.T + 1e-3 * len(y) * 0.01 * np.eye(2)
        lean = np.asarray(np.linalg.solve(normal, (x * weight) @ y), np.float64)
        rest = y - lean @ x
        spread = 1.5 * float(np.median(np.abs(rest))) + 1e-6
        weight = np.asarray(1.0 / (1.0 + np.square(rest / (2.0 * spread))), np.float64)
    most = ROOM.steepest
    return (float(np.clip(lean[0], -most, most)), float(np.clip(lean[1], -most, most)))


def less_room(registration: Registration) -> tuple[Registration, float]:
    """Flash photographs without what the room added, and the share of the first one's light it was.

    Unchanged, and 0, where no photograph shows the room's light, or its exposure is not known.
    """
    *lit, room = registration.views
    if room.flash:
        return registration, 0.0
    cleaned, shares = [], []
    for view in lit:
        amount = _amount(view.photo, room.photo)
        if amount is None:
            return registration, 0.0
        photo, share = _without(view, room, amount)
        cleaned.append(replace(view, photo=photo))
        shares.append(share)
    return replace(registration, views=(*cleaned, room)), shares[0]


def _amount(flash: Photo, room: Photo) -> NDArray[np.float64] | None:
    """(3,) how much larger the room's light is in a flash photograph's numbers than in its own."""
    if flash.exposure is None or room.exposure is None:
        return None
    balance = np.ones(3)
    if flash.balance is not None and room.balance is not None:
        balance = np.array(flash.balance) / np.array(room.balance)
    return flash.exposure / room.exposure * balance


def _without(
    view: RegisteredView, room: RegisteredView, amount: NDArray[np.float64]
) -> tuple[Photo, float]:
    photo = view.photo
    added = _seen_from(view, room) * amount.astype(np.float32)
    # Nothing can be darker than the room alone makes it: exposure metadata is wrong at times.
    small = (64, max(8, round(64 * photo.pixels.shape[0] / photo.pixels.shape[1])))
    light, theirs = (
        np.asarray(cv2.resize(each, small, interpolation=cv2.INTER_AREA), np.float32)
        for each in (photo.pixels, added)
    )
    ratio = light / np.maximum(theirs, np.float32(1e-6))
    most = np.asarray(np.quantile(ratio.reshape(-1, 3), ROOM.bound, axis=0)).clip(max=1.0)
    added *= np.asarray(most, np.float32)
    share = float(np.median(added.mean(2) / np.maximum(photo.pixels.mean(2), 1e-6)))
    left = np.maximum(photo.pixels - added, ROOM.faintest * photo.pixels)
    # What was clipped is a lower bound still, of whatever light.
    full = photo.clipped[..., None] & (photo.pixels > FULL)
    left = np.where(full, photo.pixels, left)
    note = (
        f"{100.0 * share:.0f} % of its light was ambient, measured by {room.photo.name} and "
        "subtracted."
    )
    return replace(photo, pixels=left, notes=(*photo.notes, note)), share


def _seen_from(view: RegisteredView, room: RegisteredView) -> Picture:
    """(H, W, 3) what the room lights, as a flash photograph's camera would have seen it."""
    rows, columns = view.photo.pixels.shape[:2]
    # Looked up on few places: a camera's view of a plane is smooth.
    grid = (max(2, rows // 16), max(2, columns // 16))
    v, u = np.meshgrid(
        (np.arange(grid[0]) + 0.5) / grid[0], (np.arange(grid[1]) + 0.5) / grid[1], indexing="ij"
    )
    image = np.stack([2.0 * u - 1.0, (1.0 - 2.0 * v) * rows / columns])
    there = room.camera.sees(view.camera.on_plane(image))
    height, width = room.photo.pixels.shape[:2]
    x, y = (
        cv2.resize(each, (columns, rows), interpolation=cv2.INTER_LINEAR)
        for each in to_pixels(there, width, height)
    )
    pixels = cv2.remap(room.photo.pixels, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(pixels, np.float32)
