"""Ambient light: subtracted from flash photographs, and a photograph by it alone as a measurement.

A photograph without the flash shows albedo under light that hardly changes over the piece. Where
exposures are known what it shows is what the flash photographs have too much ([aittala2015]
takes two such photographs); and since ambient light changes slowly and leans one way, what
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
class AmbientLightSettings:
    """Model of ambient light; docs/notes/several.md."""

    noise: float = 0.08
    """Standard deviation of log radiance from the model of ambient light."""
    slow: float = 0.08
    """Deviation of the blur below which differences in illumination lie, as a share of the long
    side."""
    steepest: float = 1.0
    """Largest |d log L / d slope| of light from one side."""
    faintest: float = 0.05
    """Least share of a pixel's radiance that is left after subtraction."""
    bound: float = 0.005
    """Share of pixels that may be darker than ambient light alone would make them."""


AMBIENT = AmbientLightSettings()


@dataclass(frozen=True)
class AmbientIncidence:
    """Ambient light that arrives at a relief: L = (diffuse albedo + F0) E.

    Attributes:
        irradiance: (..., 1 or 3, h, w) E.
    """

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
class AmbientLight:
    """Ambient light, the same all over the piece: log E = lean . slope + log strength."""

    lean: tuple[float, float] = (0.0, 0.0)
    """d log L / d slope along x and y, of light from one side."""
    strength: Tensor | None = None
    """(3, 1, 1) of all of it; None for 1."""

    def onto(self, normal: Tensor) -> AmbientIncidence:
        """What arrives at a relief of unit normals (3, h, w)."""
        slopes = -normal[:2] / normal[2:].clamp_min(1e-3)
        leant = self.lean[0] * slopes[:1] + self.lean[1] * slopes[1:]
        lit = leant.clamp(-2.0, 2.0).exp()
        return AmbientIncidence(lit if self.strength is None else lit * self.strength)


def evenly_lit(
    log: Tensor, seen: Tensor, rendered: Tensor, slopes: Tensor
) -> tuple[Tensor, tuple[float, float]]:
    """An ambient photograph without slow differences in illumination, and the lean of its light.

    Args:
        log, seen: (3, h, w) its log radiance, and where it shows it.
        rendered: (3, h, w) log radiance of the maps so far under light from everywhere.
        slopes: (2, h, w) of them.
    """
    off = (log - rendered).numpy()
    mask = seen.float().numpy()
    deviation = AMBIENT.slow * max(log.shape[1:])

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
    most = AMBIENT.steepest
    return (float(np.clip(lean[0], -most, most)), float(np.clip(lean[1], -most, most)))


def without_ambient(registration: Registration) -> tuple[Registration, float]:
    """Flash photographs less their ambient light, and the share that it was of the first one's.

    Unchanged, and 0, where no photograph is by ambient light alone, or an exposure is unknown.
    """
    *lit, ambient = registration.views
    if ambient.flash:
        return registration, 0.0
    cleaned, shares = [], []
    for view in lit:
        amount = _amount(view.photo, ambient.photo)
        if amount is None:
            return registration, 0.0
        photo, share = _without(view, ambient, amount)
        cleaned.append(replace(view, photo=photo))
        shares.append(share)
    return replace(registration, views=(*cleaned, ambient)), shares[0]


def _amount(flash: Photo, ambient: Photo) -> NDArray[np.float64] | None:
    """(3,) ambient radiance in a flash photograph's pixel values over that in its own photograph's.

    Ratio of exposures and white balances; None where an exposure is unknown.
    """
    if flash.exposure is None or ambient.exposure is None:
        return None
    balance = np.ones(3)
    if flash.balance is not None and ambient.balance is not None:
        balance = np.array(flash.balance) / np.array(ambient.balance)
    return flash.exposure / ambient.exposure * balance


def _without(
    view: RegisteredView, ambient: RegisteredView, amount: NDArray[np.float64]
) -> tuple[Photo, float]:
    photo = view.photo
    added = _seen_from(view, ambient) * amount.astype(np.float32)
    # Nothing can be darker than under ambient light alone: exposure metadata is wrong at times.
    small = (64, max(8, round(64 * photo.pixels.shape[0] / photo.pixels.shape[1])))
    light, theirs = (
        np.asarray(cv2.resize(each, small, interpolation=cv2.INTER_AREA), np.float32)
        for each in (photo.pixels, added)
    )
    ratio = light / np.maximum(theirs, np.float32(1e-6))
    most = np.asarray(np.quantile(ratio.reshape(-1, 3), AMBIENT.bound, axis=0)).clip(max=1.0)
    added *= np.asarray(most, np.float32)
    share = float(np.median(added.mean(2) / np.maximum(photo.pixels.mean(2), 1e-6)))
    left = np.maximum(photo.pixels - added, AMBIENT.faintest * photo.pixels)
    # What was clipped is a lower bound still, of whatever light.
    full = photo.clipped[..., None] & (photo.pixels > FULL)
    left = np.where(full, photo.pixels, left)
    note = (
        f"{100.0 * share:.0f} % of its light was ambient, measured by {ambient.photo.name} and "
        "subtracted."
    )
    return replace(photo, pixels=left, notes=(*photo.notes, note)), share


def _seen_from(view: RegisteredView, ambient: RegisteredView) -> Picture:
    """(H, W, 3) the ambient photograph resampled to a flash photograph's pixels."""
    rows, columns = view.photo.pixels.shape[:2]
    # Looked up on few places: a camera's view of a plane is smooth.
    grid = (max(2, rows // 16), max(2, columns // 16))
    v, u = np.meshgrid(
        (np.arange(grid[0]) + 0.5) / grid[0], (np.arange(grid[1]) + 0.5) / grid[1], indexing="ij"
    )
    image = np.stack([2.0 * u - 1.0, (1.0 - 2.0 * v) * rows / columns])
    there = ambient.camera.sees(view.camera.on_plane(image))
    height, width = ambient.photo.pixels.shape[:2]
    x, y = (
        cv2.resize(each, (columns, rows), interpolation=cv2.INTER_LINEAR)
        for each in to_pixels(there, width, height)
    )
    pixels = cv2.remap(
        ambient.photo.pixels, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(pixels, np.float32)
