"""Photo: linear pixels, clipping mask, tone curve and metadata of a photograph."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from matcap.errors import MatcapError
from matcap.files.containers import check_pixels
from matcap.files.settings import bounded

# The tone curve of a developed picture, which comes before the colour space's own curve.
#
# g(x) = x^c / (1 - w + w x^c),    g(0) = 0,  g(1) = 1,
#
# with x light over the clip level: contrast by the exponent c, a shoulder by w. It is one curve for
# all channels. c is fitted with the photograph's light (flash/coarse); w hardly shows in one and
# is held at a phone's.

SHOULDER = 0.27  # w of a developed picture; fitted as well, it hardly moves (docs/notes/gloss.md)


@dataclass(frozen=True)
class Development:
    """Prior of a developed picture's tone curve, by default that of a phone's JPEG."""

    log_exponent: float = 0.12
    """Mean of log c."""
    deviation: float = 0.08
    """Standard deviation of log c."""
    shoulder: float = SHOULDER
    """w, held."""


# Base and HDR gain map together: the shoulder is undone. A wider prior takes a part of every
# highlight for contrast: log exponents of 0.05 to 0.10 where it is 0 (docs/notes/gloss.md).
WITH_GAIN_MAP = Development(0.01, 0.02, 0.0)
# The same where the map has no gain for middle tones: these are as a phone's JPEG has them.
WITH_BRIGHT_GAINS = Development(shoulder=0.0)


@dataclass(frozen=True)
class ToneCurve:
    """g with its two numbers; by default the identity."""

    exponent: float = 1.0
    """Exponent c, above 0."""
    shoulder: float = 0.0
    """Weight w of the shoulder, in [0, 1)."""

    @staticmethod
    def of_report(report: dict[str, Any]) -> ToneCurve:
        """Tone curve of a capture's photograph by report.json; the identity without one."""
        try:
            stated = report["camera"]["tone_curve"]
            return ToneCurve(
                bounded(stated["exponent"], "exponent", 0.1, 10.0),
                bounded(stated["shoulder"], "shoulder", 0.0, 0.99),
            )
        except (KeyError, TypeError, ValueError):
            return ToneCurve()

    def developed(self, light: NDArray[Any]) -> NDArray[Any]:
        """Light at least 0 through the curve, any shape; beyond the clip level it stays beyond."""
        if self == ToneCurve():
            return light
        power = np.power(light, self.exponent)
        return np.asarray(power / (1.0 + self.shoulder * (power - 1.0)), light.dtype)

    def linear(self, picture: NDArray[Any]) -> NDArray[Any]:
        """The inverse of developed() up to white; beyond it, below a shoulder, ratios are kept."""
        if self == ToneCurve():
            return picture
        if self.shoulder == 0.0:
            return np.asarray(np.power(picture, 1.0 / self.exponent), picture.dtype)
        within = np.minimum(picture, 1.0)
        power = within * (1.0 - self.shoulder) / (1.0 - self.shoulder * within)
        light = np.power(power, 1.0 / self.exponent) * np.maximum(picture, 1.0)
        return np.asarray(light, picture.dtype)

    def slope_by_shoulder(self, picture: NDArray[Any]) -> NDArray[Any]:
        """Derivative by w of log(d log y / d log light), at developed light y in [0, 1]."""
        return np.asarray(-picture / (1.0 - self.shoulder * picture), picture.dtype)


SHORTEST_SIDE = 64  # pixels, least short side


def check_size(path: Path, width: int, height: int) -> None:
    """Refuse pictures that are too small for a texture, or too large.

    Raises:
        MatcapError: the short side is less than SHORTEST_SIDE, or there are more than MOST_PIXELS.
    """
    check_pixels(path, width, height)
    if min(width, height) < SHORTEST_SIDE:
        raise MatcapError.at(
            path,
            f"the picture is {width} x {height} pixels, too small to hold a texture",
            f"give one of at least {SHORTEST_SIDE} pixels on its short side",
        )


# Photo: linear pixels, clipping mask and metadata of a photograph file; Decoded, before checks.

FULL = 0.95  # of the clip level: channels of a clipped pixel above this count as clipped


@dataclass(frozen=True)
class Photo:
    """A scene-linear, white-balanced photograph, long side along x."""

    pixels: NDArray[np.float32]
    """(H, W, 3) float32, W >= H, linear Rec.709, finite, >= 0, in units of the file's white.
    Light above white is measured where `clipped` is False."""
    clipped: NDArray[np.bool_]
    """(H, W) bool, pixels of which a channel reached the clip level, `headroom`."""
    fov: float = math.nan
    """Field of view across the long side, degrees."""
    fov_source: str = "assumed"
    """"exif", "assumed" or "given"."""
    radiometric: bool = False
    """Whether values are proportional to radiance (RAW only)."""
    name: str = ""
    """File name without folder."""
    original_size: tuple[int, int] = (0, 0)
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


@dataclass(frozen=True)
class Decoded:
    """A reader's result: a photograph as the file stores it, before it is checked and turned."""

    photo: Photo
    """Downsampled, its `original_size` as stored; without what the metadata say."""
    orientation: int | None = None
    """EXIF's 1 to 8, not yet applied, by the decoder; None is the metadata's."""
    opacity: NDArray[np.float32] | None = None
    """(h, w) float32 in [0, 1], or None if all is opaque."""
    whole: tuple[int, int] | None = None
    """(width, height) of the picture that focal lengths refer to, if this is a part of it."""


Scalar = TypeVar("Scalar", bound=np.generic)


def quarter_turn(picture: NDArray[Scalar]) -> NDArray[Scalar]:
    """Rotate (H, W, ...) by 90 degrees counterclockwise: the right side becomes the top."""
    return np.rot90(picture)


def standing(picture: NDArray[Scalar]) -> NDArray[Scalar]:
    """The inverse of quarter_turn, contiguous."""
    return np.ascontiguousarray(np.rot90(picture, -1))
