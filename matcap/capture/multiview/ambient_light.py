"""Ambient light: its subtraction, and a photograph without flash as a measurement of albedo.

A photograph without flash shows albedo under nearly uniform light. With known exposures it is
subtracted from the flash photographs (as the pair of [aittala2015]). As ambient light varies
slowly over the sample, the high frequencies of this photograph measure albedo.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import by_slopes
from matcap.capture.exemplar.relief_spectrum import local_mean
from matcap.capture.registration.camera import to_pixels
from matcap.capture.registration.register import RegisteredView
from matcap.flash.light import Incident
from matcap.photo.left_out import area_averaged
from matcap.photo.photo import Photo

Picture = NDArray[np.float32]
Views = tuple[RegisteredView, ...]  # at most one without flash, the last

# Model of ambient light; docs/notes/several.md.
AMBIENT_NOISE = 0.05  # standard deviation of log radiance from the model of ambient light
# Standard deviation of the low-pass that separates illumination, as a share of the long side.
SLOW = 0.08
UNIFORM_SKY = (0.0, 0.0, 0.5)  # prior mean of AmbientLight.gradient
GRADIENT_DEVIATION = 0.25  # prior standard deviation of its x and y
_DARKEST = 0.05  # least irradiance of any normal, over that of a level surface
_FAINTEST = 0.05  # least share of a pixel's radiance that remains after subtraction
_BOUND = 0.005  # share of pixels that may be darker than under ambient light alone


@dataclass(frozen=True)
class AmbientIncidence(Incident):
    """Ambient light incident on a relief: L = (diffuse albedo + F0) E."""

    irradiance: Tensor
    """(1 or 3, h, w) E."""

    def matte(self, albedo: Tensor) -> Tensor:
        """The albedo itself."""
        return albedo

    def mirrored(self, specular: Tensor, roughness: Tensor) -> Tensor:
        """F0 itself, with the shape of both."""
        return specular + 0.0 * roughness


@dataclass(frozen=True)
class AmbientLight:
    """Ambient light: irradiance as spherical harmonics of first order [ramamoorthi2001].

    E(n) = strength (1 + x n_x + y n_y + z (n_z - 1)), relative to a level surface, n = (0, 0, 1).
    """

    gradient: Tensor = field(default_factory=lambda: torch.tensor(UNIFORM_SKY))
    """(3,) x, y and z; (0, 0, 0.5) under a uniform sky."""
    strength: Tensor = field(default_factory=lambda: torch.ones(1, 1, 1))
    """(1 or 3, 1, 1) irradiance of a level surface."""

    def onto(self, normal: Tensor) -> AmbientIncidence:
        """Irradiance of a relief with unit normals (3, h, w)."""
        change = torch.cat([normal[:2], normal[2:] - 1.0])
        irradiance = 1.0 + torch.tensordot(self.gradient.to(change), change, 1)[None]
        return AmbientIncidence(irradiance.clamp_min(_DARKEST) * self.strength)

    def log_gradient(
        self, normal: Tensor, specular: Tensor, roughness: Tensor
    ) -> tuple[AmbientIncidence, Tensor, Tensor]:
        """As DifferentiableLight.log_gradient; of the lobe, only F0 changes the radiance."""
        lit, gradient = self.onto(normal), self.gradient.to(normal)[:, None, None]
        level = lit.irradiance[:1] / self.strength[:1]
        lobe = torch.zeros_like(normal[:1]).repeat(4, 1, 1)
        lobe[0] = 1.0
        return lit, lobe, by_slopes(normal, gradient) / level


def evenly_lit(log: Tensor, seen: Tensor, rendered: Tensor) -> Tensor:
    """Log radiance of an ambient photograph, its low frequencies replaced by those of `rendered`.

    Args:
        log: (3, h, w) log radiance of the photograph.
        seen: (3, h, w) bool, where that is valid.
        rendered: (3, h, w) log radiance of the current maps in uniform ambient light.
    """
    deviation = SLOW * max(log.shape[1:])
    both = zip((log - rendered).numpy(), seen.float().numpy(), strict=True)
    fine = np.stack([plane - local_mean(plane, weight, deviation) for plane, weight in both])
    return rendered + torch.from_numpy(fine)


def without_ambient(views: Views) -> Views:
    """Subtract ambient light from flash photographs.

    Returns the photographs unchanged if none is without flash or an exposure is unknown.
    """
    *lit, ambient = views
    if ambient.flash:
        return views
    cleaned = []
    for view in lit:
        amount = _amount(view.photo, ambient.photo)
        if amount is None:
            return views
        cleaned.append(replace(view, photo=_without(view, ambient, amount)))
    return (*cleaned, ambient)


def _amount(flash: Photo, ambient: Photo) -> NDArray[np.float64] | None:
    """(3,) factor from pixel values of the ambient photograph to those of a flash photograph.

    Ratio of exposures and white balances; None where an exposure is unknown.
    """
    if flash.exposure is None or ambient.exposure is None:
        return None
    balance = np.ones(3)
    if flash.balance is not None and ambient.balance is not None:
        balance = np.array(flash.balance) / np.array(ambient.balance)
    return flash.exposure / ambient.exposure * balance


def _without(view: RegisteredView, ambient: RegisteredView, amount: NDArray[np.float64]) -> Photo:
    """A flash photograph less `amount` times the ambient one; the median share of that is noted."""
    photo = view.photo
    added = _seen_from(view, ambient) * amount.astype(np.float32)
    # No pixel can be darker than under ambient light alone; exposure metadata can be wrong.
    small = (64, round(64 * photo.pixels.shape[0] / photo.pixels.shape[1]))
    total, by_ambient = (area_averaged(each, small) for each in (photo.pixels, added))
    ratio = total / np.maximum(by_ambient, np.float32(1e-6))
    most = np.asarray(np.quantile(ratio.reshape(-1, 3), _BOUND, axis=0)).clip(max=1.0)
    added *= np.asarray(most, np.float32)
    share = float(np.median(added.mean(2) / np.maximum(photo.pixels.mean(2), 1e-6)))
    left = np.maximum(photo.pixels - added, _FAINTEST * photo.pixels)
    # Clipped pixels remain lower bounds.
    left = np.where(photo.full, photo.pixels, left)
    note = (
        f"{100.0 * share:.0f} % of its light was ambient, measured by {ambient.photo.name} and "
        "subtracted."
    )
    return replace(photo, pixels=left, notes=(*photo.notes, note))


def _seen_from(view: RegisteredView, ambient: RegisteredView) -> Picture:
    """(H, W, 3) the ambient photograph resampled to a flash photograph's pixels."""
    rows, columns = view.photo.pixels.shape[:2]
    # Project a coarse grid and interpolate: a camera's projection of a plane is smooth.
    grid = (max(2, rows // 16), max(2, columns // 16))
    v, u = np.meshgrid(
        (np.arange(grid[0]) + 0.5) / grid[0], (np.arange(grid[1]) + 0.5) / grid[1], indexing="ij"
    )
    image = np.stack([2.0 * u - 1.0, (1.0 - 2.0 * v) * rows / columns])
    height, width = ambient.photo.pixels.shape[:2]
    places = to_pixels(ambient.camera.sees(view.camera.on_plane(image)), width, height)
    x, y = (cv2.resize(each, (columns, rows), interpolation=cv2.INTER_LINEAR) for each in places)
    pixels = cv2.remap(
        ambient.photo.pixels, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(pixels, np.float32)
