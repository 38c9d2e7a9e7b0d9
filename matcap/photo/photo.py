"""Photo: linear pixels, clipping mask and metadata of a photograph file; Decoded, before checks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from matcap.photo.tone import Development, ToneCurve

FULL = 0.95  # of the clip level: channels of a clipped pixel above this count as clipped


@dataclass(frozen=True)
class Decoded:
    """A reader's result: a linear picture, in the orientation in which the file stores it."""

    pixels: NDArray[np.float32]
    """(h, w, 3) float32 linear Rec.709, at least 0, downsampled."""
    clipped: NDArray[np.bool_]
    """(h, w) bool."""
    size: tuple[int, int]
    """(width, height) as stored, before downsampling."""
    orientation: int = 1
    """EXIF's 1 to 8, not yet applied."""
    radiometric: bool = False
    """As in Photo."""
    linear: bool = False
    """Whether codes are proportional to light, so that a tone curve is unlikely."""
    headroom: float = 1.0
    """As in Photo."""
    floating: bool = False
    """As in Photo."""
    development: Development = Development()
    """As in Photo."""
    gain_map_applied: bool = False
    notes: tuple[str, ...] = ()
    """As in Photo."""
    clipped_share: float | None = None
    """Share of the stored pixels (of a RAW: of the photosites of the colour that clips most) at the
    clip level, or None if only `clipped` is known."""
    noise: NDArray[np.float32] | None = None
    balance: tuple[float, float, float] | None = None
    """As in Photo."""
    opacity: NDArray[np.float32] | None = None
    """(h, w) float32 in [0, 1], or None if all is opaque."""


@dataclass(frozen=True)
class Photo:
    """A scene-linear, white-balanced photograph, long side along x."""

    pixels: NDArray[np.float32]
    """(H, W, 3) float32, W >= H, linear Rec.709, finite, >= 0, in units of the file's white.
    Light above white is measured where `clipped` is False."""
    clipped: NDArray[np.bool_]
    """(H, W) bool, pixels of which a channel reached the clip level, `headroom`."""
    fov: float
    """Field of view across the long side, degrees."""
    fov_source: str
    """"exif", "assumed" or "given"."""
    radiometric: bool
    """Whether values are proportional to radiance (RAW only)."""
    name: str
    """File name without folder."""
    original_size: tuple[int, int]
    """(width, height) of the file's upright picture, before resizing."""
    turned: bool = False
    """Whether the photograph is a portrait, rotated by 90 degrees counterclockwise to landscape."""
    flash_fired: bool | None = None
    """Whether the flash fired, by the file's metadata; or None."""
    gain_map_applied: bool = False
    """Whether a DNG lens-shading map was applied."""
    notes: tuple[str, ...] = ()
    """Sentences for the report."""
    stored_clipped_share: float | None = None
    """Share of the file's pixels at the clip level, or None. `clipped` overestimates it: a
    downsampled pixel counts if a quarter of it was clipped."""
    flash_intensity: float | None = None
    """Radiant intensity of the flash in units of `pixels` times plane units squared, measured by a
    calibration card; or None. With it, albedo is absolute."""
    path: Path | None = None
    """Absolute path of the file, or None."""
    noise: NDArray[np.float32] | None = None
    """(H, W, 3) float32, an independent sample of the sensor noise in `pixels`; None if unknown or
    negligible after downsampling."""
    left_out: NDArray[np.bool_] | None = None
    """(H, W) bool, pixels that do not show the material (left_out.py), or None."""
    exposure: float | None = None
    """Exif.exposure, or None; values are proportional to it for the same radiance."""
    balance: tuple[float, float, float] | None = None
    """White-balance gains by channel, or None."""
    tone: ToneCurve | None = None
    """The tone curve that was removed from `pixels`; None if one may still be in them."""
    headroom: float = 1.0
    """Radiance at which a channel clips, in units of white; infinite if nothing does. Lens shading
    and colours outside Rec.709 may exceed it."""
    floating: bool = False
    """Whether the file holds floating-point numbers, which have no quantisation noise."""
    development: Development = Development()
    """Prior of the tone curve, where one may be in `pixels`."""

    @property
    def full(self) -> NDArray[np.bool_]:
        """(H, W, 3) bool, channels whose values are lower bounds: of a clipped pixel those at white
        or above.
        """
        return self.clipped[..., None] & (self.pixels > FULL * min(self.headroom, 1.0))

    @property
    def tone_mapped(self) -> bool:
        """Whether an unknown tone curve may be in `pixels`."""
        return self.tone is None and not self.radiometric

    def linearised(self, tone: ToneCurve) -> Photo:
        """The photograph without a tone curve; unchanged if it has none."""
        if not self.tone_mapped:
            return self
        headroom = float(tone.linear(np.array(self.headroom)))
        return replace(self, pixels=tone.linear(self.pixels), headroom=headroom, tone=tone)

    def developed(self, linear: NDArray[np.float32]) -> NDArray[np.float32]:
        """Radiance (H, W, 3) with the tone curve that was removed from `pixels`."""
        return linear if self.tone is None else self.tone.developed(linear)

    @property
    def stem(self) -> str:
        """The file name without its suffix."""
        return self.name.rsplit(".", 1)[0] or self.name

    @property
    def remarks(self) -> tuple[str, ...]:
        """Notes of reading the file, including an assumed field of view."""
        if self.path is None or self.fov_source != "assumed":
            return self.notes
        says = (
            f"The file does not say its field of view: {self.fov:.0f} degrees assumed, "
            "as a phone's main camera has (--fov)."
        )
        return (*self.notes, says)

    @property
    def kept_share(self) -> float:
        """Share of the pixels that are not left out."""
        return 1.0 if self.left_out is None else 1.0 - float(self.left_out.mean())

    @property
    def clipped_share(self) -> float:
        """Share of pixels at the clip level."""
        if self.stored_clipped_share is not None:
            return self.stored_clipped_share
        return float(self.clipped.mean())
