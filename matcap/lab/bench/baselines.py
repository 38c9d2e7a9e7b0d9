"""What a capture must beat: the photograph as albedo.

It is given the true camera and flash, which a capture has to find out.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.flash.geometry import FlashSetup
from matcap.flash.rectify import rectify
from matcap.flash.render import render_rectified
from matcap.photo.photo import Photo

_SPECULAR, _ROUGHNESS = 0.04, 0.5


@dataclass(frozen=True)
class Fixed:
    """Maps that are all there is: asked for less, the middle is given.

    Attributes:
        whole: the maps.
        setup: camera and flash they go with.
    """

    whole: MapSet
    setup: FlashSetup

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units."""
        return self.whole.texel_size

    def maps(self, width: int, height: int, *, seed: int = 0) -> MapSet:
        """The middle of the maps; `seed` cannot make more of them."""
        have_width, have_height = self.whole.size
        if width > have_width or height > have_height:
            raise UsageError(
                f"the photograph gives {have_width} x {have_height} texels of map, "
                f"{width} x {height} were asked for"
            )
        x, y = (have_width - width) // 2, (have_height - height) // 2
        return self.whole.crop(x, y, width, height)


def photo_as_albedo(photo: Photo, setup: FlashSetup, detail: int) -> Fixed:
    """The photograph itself as diffuse albedo; constant F0 and roughness; flat.

    The flash's intensity is the one that gives the photograph's mean back.

    Args:
        photo: the photograph.
        setup: true geometry.
        detail: texels along the long side.
    """
    linear, _ = rectify(photo, setup, detail)
    diffuse = linear.clamp(0.0, 1.0)
    flat = torch.zeros_like(diffuse[:1])
    maps = MapSet(diffuse, flat + _SPECULAR, flat + _ROUGHNESS, flat, texel_size=2.0 / detail)
    again = render_rectified(maps, setup.with_intensity((1.0, 1.0, 1.0))).clamp_min(0.0)
    gain = float(linear.mean() / again.mean())
    return Fixed(maps, setup.with_intensity((gain, gain, gain)))
