"""What gloss may go with: lightness and colour, and roughness with relief's bands, too.

Gloss shows near the highlight alone; albedo and relief show everywhere. Where gloss goes with them
(bare metal is grey between rust, grooves are rougher than ridges) they carry it to the rest. F0 is
the substance's, which relief does not change.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.capture.piece.tuned import ADAPT


@dataclass(frozen=True)
class Ties:
    """Features of every texel.

    Attributes:
        features: (N, H, W) of unit deviation: lightness, colour, then bands of relief.
        lightness, colour: deviations of their logarithms.
    """

    features: Tensor
    lightness: float
    colour: float

    def deviations(self) -> tuple[list[float], list[float]]:
        """How far a deviation of a feature is believed to move F0, and roughness (logits)."""
        of_specular, of_roughness = (
            [by_light * self.lightness, by_colour * self.colour]
            for by_light, by_colour in (ADAPT.tie_specular, ADAPT.tie_roughness)
        )
        bands = len(self.features) - len(of_roughness)
        return of_specular, of_roughness + [ADAPT.tie_band] * bands


def ties(diffuse: Tensor, bands: Tensor | None = None) -> Ties:
    """Features of albedo (3, H, W) and, if given, of bands of height (>= 4, H, W).

    Colour is what varies most of the channels' logarithms beside lightness.
    """
    logs = diffuse.clamp_min(ADAPT.tie_darkest).log()
    lightness = logs.mean(0)
    colours = (logs - lightness).flatten(1)
    colours = colours - colours.mean(1, keepdim=True)
    most = torch.linalg.eigh(colours @ colours.T)[1][:, -1]
    planes = [lightness, (most @ colours).view_as(lightness)]
    if bands is not None:
        planes += [bands[0] + bands[1], bands[2], bands[3:-1].sum(0)]
    stacked = torch.stack(planes)
    stacked = stacked - stacked.mean((1, 2), keepdim=True)
    spread = stacked.std((1, 2), keepdim=True)
    features = (stacked / spread.clamp_min(1e-6)).clamp(-ADAPT.tie_farthest, ADAPT.tie_farthest)
    return Ties(features, float(spread[0]), float(spread[1]))
