"""Baseline methods that make maps of a photograph, and the capture itself.

The photograph as albedo is what a capture must beat; it is given the true camera and flash, which
a capture has to find out. The exemplar and the field that rearranges it need no decoder: coarse
fit, inverse network, refinement, index.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from matcap.brdf.maps import CHANNELS, MapSet
from matcap.capture.method import Method
from matcap.capture.piece.find import ExemplarEstimate, piece_maps
from matcap.capture.pipeline import capture_photo, read_photograph
from matcap.capture.settings import PRESETS, CaptureSettings
from matcap.errors import UsageError
from matcap.example.example import Example
from matcap.example.exemplar import Exemplar
from matcap.field.plane import Rectangle
from matcap.flash.geometry import FlashSetup
from matcap.flash.rectify import rectify
from matcap.flash.render import render_rectified
from matcap.lab.simulate.materials import realise
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


@dataclass(frozen=True)
class Rearranged:
    """An example as an endless field.

    Attributes:
        example: what is rearranged.
        setup: camera and flash it goes with.
    """

    example: Example
    setup: FlashSetup

    @property
    def texel_size(self) -> float:
        """A texel's side in plane units."""
        return self.example.exemplar.texel_size

    def maps(self, width: int, height: int, *, seed: int = 0) -> MapSet:
        """One realisation."""
        stacked = torch.from_numpy(self.example.maps(seed, Rectangle(0, 0, width, height), None))
        return MapSet.from_stacked(stacked, self.texel_size)


def capture_exemplar(path: Path, detail: int) -> tuple[ExemplarEstimate, FlashSetup]:
    """The exemplar of a photograph's file, and its setup as fitted."""
    settings = CaptureSettings(steps=0, detail=detail, aligned=True)  # no decoder is asked for
    method = Method(adapted=PRESETS["standard"].adapted)
    photo = read_photograph(path, settings, method)
    result = capture_photo(photo, settings, method=method)
    assert result.estimate is not None
    return result.estimate, result.material.setup


def photographed_exemplar(path: Path, detail: int) -> Fixed:
    """The maps themselves."""
    piece, setup = capture_exemplar(path, detail)
    return Fixed(piece_maps(piece.exemplar), setup)


def rearranged_exemplar(path: Path, detail: int) -> Rearranged:
    """More of them."""
    piece, setup = capture_exemplar(path, detail)
    return Rearranged(piece.example, setup)


def true_exemplar(
    material: str, width: int, height: int, seed: int = 11, detail: int = 1024
) -> Exemplar:
    """The true maps of a simulated material as an exemplar."""
    return exemplar_of(realise(material, width, height, seed, 2.0 / detail))


def exemplar_of(maps: MapSet) -> Exemplar:
    """True maps as an exemplar that is trusted everywhere."""
    planes = {name: np.ascontiguousarray(getattr(maps, name).float().numpy()) for name in CHANNELS}
    width, height = maps.size
    trusted = np.ones((len(CHANNELS), height, width), np.float32)
    return Exemplar(**planes, confidence=trusted, texel_size=maps.texel_size)
