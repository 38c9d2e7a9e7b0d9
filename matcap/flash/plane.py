"""Plane: a photograph rectified to the sample's plane, with validity and noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.flash.extent import Extent, Margins
from matcap.flash.geometry import FlashSetup
from matcap.flash.rectify import kept, measured, rectify, rectify_noise
from matcap.photo.photo import Photo
from matcap.photo.shrink import CLIPPED_SHARE
from matcap.statistics.encoding import Encoding, fit_encoding


@dataclass(frozen=True)
class Plane:
    """A rectified photograph."""

    linear: Tensor
    """(3, H, W) scene-linear picture with its shading."""
    valid: Tensor
    """(H, W) bool, texels inside of the photograph and not clipped."""
    noise: Tensor | None
    """(3, H, W) a sample of the sensor noise model, in the picture's units, or None if unknown."""
    encoding: Encoding
    """Colour space in which its texture is compared."""
    channels: Tensor | None = None
    """(3, H, W) bool, the same by channel; None for `valid` in all channels."""
    left_out: Tensor | None = None
    """(H, W) bool, masked texels, which are filled by mirrored ones; None without a mask."""
    developed: bool = False
    """Whether the picture is developed (8-bit codes), not RAW or floating-point."""
    margins: Margins = Margins()
    """Margins of a mosaic's grid around the photograph's own."""

    @property
    def measured(self) -> Tensor:
        """(3, H, W) bool: where each channel is a measurement, not a bound."""
        if self.channels is None:
            return self.valid.expand(3, -1, -1)
        return self.channels | self.valid

    @property
    def kept(self) -> Tensor:
        """(H, W) bool: texels of the material; all without a mask."""
        return torch.ones_like(self.valid) if self.left_out is None else ~self.left_out

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in texels."""
        return self.linear.shape[-1], self.linear.shape[-2]

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units: the width spans x in [-1, 1]."""
        return self.extent.texel(self.linear.shape[-1])

    @property
    def extent(self) -> Extent:
        """Extent of its grid on the plane."""
        return self.margins.extent(self.linear.shape[-1] - self.margins.left - self.margins.right)

    @property
    def unit(self) -> float:
        """Texels along the photograph's long side, of which a mosaic has more."""
        return self.extent.unit(self.linear.shape[-1])

    def encoded(self) -> Tensor:
        """(3, H, W) texture colour of about unit variance, shading included."""
        return self.encoding(self.linear[None])[0]

    def brightened(self, gain: float) -> Plane:
        """The picture times `gain`; the encoding is not changed."""
        noise = None if self.noise is None else self.noise * gain
        return replace(self, linear=self.linear * gain, noise=noise)

    def shrunk(self, columns: int) -> Plane:
        """Area average on a coarser grid, `columns` texels across."""
        width, height = self.size
        size = [max(1, round(height * columns / width)), columns]

        def mean(planes: Tensor) -> Tensor:
            return F.interpolate(planes[None], size=size, mode="area")[0]

        def whole(seen: Tensor) -> Tensor:
            return mean(seen.float()) > 1.0 - CLIPPED_SHARE

        linear, valid = mean(self.linear), whole(self.valid[None])[0]
        noise = None if self.noise is None else mean(self.noise)
        left_out = None if self.left_out is None else ~whole(~self.left_out[None])[0]
        shrunk = plane_of(linear, valid, noise, self.encoding.limit)
        return replace(
            shrunk,
            channels=whole(self.measured),
            left_out=left_out,
            developed=self.developed,
        )

    def over(self, margins: Margins, known: Tensor) -> Plane:
        """The plane padded to the grid of a mosaic, invalid beyond its own texels.

        Args:
            margins: of the mosaic.
            known: (H, W) bool on the mosaic; texels that are not known are masked.
        """

        def padded(planes: Tensor) -> Tensor:
            pad = (margins.left, margins.right, margins.top, margins.bottom)
            return F.pad(planes[None], pad, mode="replicate")[0]

        return replace(
            self,
            linear=padded(self.linear),
            valid=margins.padded(self.valid),
            noise=None if self.noise is None else padded(self.noise),
            channels=margins.padded(self.measured),
            left_out=~known,
            margins=margins,
        )


def read_plane(photo: Photo, setup: FlashSetup, detail: int) -> Plane:
    """Rectify a photograph to the plane's grid.

    Args:
        photo: the photograph.
        setup: its geometry; only field of view and tilt matter here.
        detail: texels along the long side.
    """
    linear, valid = rectify(photo, setup, detail)
    whole = plane_of(linear, valid, rectify_noise(photo, setup, detail), photo.headroom)
    masked = photo.left_out is not None
    left_out = ~torch.from_numpy(kept(photo, setup, detail)) if masked else None
    return replace(
        whole,
        channels=measured(photo, setup, detail),
        left_out=left_out,
        developed=not (photo.radiometric or photo.floating),
    )


def plane_of(
    linear: Tensor, valid: Tensor, noise: Tensor | None = None, headroom: float = 1.0
) -> Plane:
    """Plane of a rectified picture that clips at `headroom`, with its own encoding."""
    return Plane(linear, valid, noise, fit_encoding(linear, valid, noise, headroom))
