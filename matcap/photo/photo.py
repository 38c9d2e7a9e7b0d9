"""Photo: linear pixels, clipping mask and metadata of a photograph file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from matcap.photo.camera import CameraProfile

FULL = 0.95  # of the clip level: a clipped pixel's channels above this did it
DEFAULT_FOV = 45.0  # degrees across the long side, where the file does not say (the paper's)


@dataclass(frozen=True)
class Photo:
    """A scene-linear, white-balanced photograph, long side along x.

    Attributes:
        pixels: (H, W, 3) float32, W >= H, linear Rec.709, finite, >= 0; the file clips at 1.0
            (lens shading undone and colours outside Rec.709 may lie above).
        clipped: (H, W) bool, True where any channel reached the clip level: a lower bound only.
        fov: field of view across the long side, degrees.
        fov_source: "exif", "assumed" or "given".
        radiometric: True only when the numbers are proportional to light (RAW).
        name: the file's name without folder.
        original_size: (width, height) of the file's picture after orientation, before resizing.
        turned: a portrait picture, turned a quarter turn anticlockwise so that its long side
            lies along x.
        flash_fired: what the file says, or None.
        gain_map_applied: a DNG lens-shading map was found and applied.
        notes: plain sentences for the report (profile converted, gain map present, ...).
        stored_clipped_share: share of the file's own pixels at the clip level, where known:
            `clipped` overstates it, for a shrunk pixel counts when a quarter of it was clipped.
        flash_intensity: radiant intensity of the flash in the units of `pixels`, where a
            calibration card measured it: albedo is absolute then.
        path: where the file was read, absolute; None where there was no file.
        noise: (H, W, 3) float32, what one more draw of the sensor's noise would have added to
            `pixels`; None where it is unknown or has averaged out.
        left_out: (H, W) bool, what is not the material (left_out.py): nothing is measured there;
            None where all of it is.
        exposure: what the file says of exposure time, sensitivity and aperture together: how much
            larger numbers are for the same light; None where it does not say.
        balance: by channel, how much white balance lifted it; None where it is unknown.
        camera: maker, model, lens, focal length and zoom as the file says; "" where it does not.
        profile: of the camera, where one is known: the prior of its falloff.
    """

    pixels: NDArray[np.float32]
    clipped: NDArray[np.bool_]
    fov: float
    fov_source: str
    radiometric: bool
    name: str
    original_size: tuple[int, int]
    turned: bool = False
    flash_fired: bool | None = None
    gain_map_applied: bool = False
    notes: tuple[str, ...] = ()
    stored_clipped_share: float | None = None
    flash_intensity: float | None = None
    path: Path | None = None
    noise: NDArray[np.float32] | None = None
    left_out: NDArray[np.bool_] | None = None
    exposure: float | None = None
    balance: tuple[float, float, float] | None = None
    camera: str = ""
    profile: CameraProfile | None = None

    @property
    def stem(self) -> str:
        """The file's name without its ending."""
        return self.name.rsplit(".", 1)[0] or self.name

    def known_by(self, profile: CameraProfile) -> Photo:
        """The same with its camera's profile; a note says if that is another camera's."""
        said = f"The camera's profile is of {profile.camera}, the photograph of {self.camera}."
        foreign = self.camera not in profile.camera
        return replace(self, profile=profile, notes=(*self.notes, said) if foreign else self.notes)

    @property
    def remarks(self) -> tuple[str, ...]:
        """All that was assumed, converted or left undone when it was read from a file."""
        if self.path is None or self.fov_source != "assumed":
            return self.notes
        says = f"The file does not say its field of view: {self.fov:g} degrees assumed (--fov)."
        return (*self.notes, says)

    @property
    def kept_share(self) -> float:
        """Share of the picture that is the material."""
        return 1.0 if self.left_out is None else 1.0 - float(self.left_out.mean())

    @property
    def clipped_share(self) -> float:
        """Share of pixels at the clip level."""
        if self.stored_clipped_share is not None:
            return self.stored_clipped_share
        return float(self.clipped.mean())
