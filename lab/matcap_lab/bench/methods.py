"""Baseline methods that make maps of a photograph, and the capture itself.

The baseline is the photograph as albedo; it is given the true camera and flash, which a capture has
to estimate. Exemplar and field need no decoder: coarse fit, inverse network, refinement, index.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from matcap.brdf.maps import MapSet
from matcap.capture.exemplar.estimate import map_set_of
from matcap.capture.result import CaptureResult
from matcap.example.exemplar import Exemplar
from matcap.field.material import Material
from matcap.flash.geometry import FlashSetup
from matcap.flash.rectify import rectify
from matcap.flash.render import render_rectified
from matcap.photo.photo import Photo
from matcap_lab.simulate.materials import realise

_SPECULAR, _ROUGHNESS = 0.04, 0.5


@dataclass(frozen=True)
class CapturedMaps:
    """Maps that a method makes of a photograph."""

    maps: MapSet
    """Maps of the photographed rectangle, or of a square of an endless field."""

    setup: FlashSetup
    """Camera and flash they go with."""


def photo_as_albedo(photo: Photo, setup: FlashSetup, detail: int) -> CapturedMaps:
    """The photograph itself as diffuse albedo; constant F0 and roughness; flat.

    Maps have `detail` texels along the long side. `setup` is the true geometry; its intensity makes
    the re-rendering's mean that of the photograph.
    """
    linear, _ = rectify(photo, setup, detail)
    diffuse = linear.clamp(0.0, 1.0)
    flat = torch.zeros_like(diffuse[:1])
    maps = MapSet(diffuse, flat + _SPECULAR, flat + _ROUGHNESS, flat, texel_size=2.0 / detail)
    again = render_rectified(maps, setup.with_intensity((1.0, 1.0, 1.0))).clamp_min(0.0)
    gain = float(linear.mean() / again.mean())
    return CapturedMaps(maps, setup.with_intensity((gain, gain, gain)))


def exemplar_maps(result: CaptureResult) -> CapturedMaps:
    """The exemplar of a capture by example."""
    assert result.estimate is not None
    return CapturedMaps(map_set_of(result.estimate.exemplar), result.material.setup)


def field_maps(material: Material, width: float, seed: int = 0) -> CapturedMaps:
    """A square of a material's endless field, `width` plane units wide."""
    side = round(width / material.texel_size)
    return CapturedMaps(material.maps(side, side, seed=seed), material.setup)


def true_exemplar(material: str, width: int, height: int, detail: int = 1024) -> Exemplar:
    """The true maps of a simulated material as an exemplar."""
    maps = realise(material, width, height, 11, 2.0 / detail)
    return Exemplar.certain(maps.stacked().float().numpy(), maps.texel_size)
