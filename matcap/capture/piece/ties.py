"""What gloss may go with: lightness, colour, and relief's bands.

Gloss shows near the highlight alone; albedo and relief show everywhere. Where gloss goes with them
(bare metal is grey between rust, grooves are rougher than ridges) they carry it to the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

_DARKEST = 1e-4  # of albedo
_FARTHEST = 3.0  # deviations: a speck's gloss is not far beyond the others'
# Logits of F0 and of roughness believed to go with a logarithm of lightness, with one of colour,
# with a deviation of a band of relief. What hardly varies tells next to nothing: a plaster has no
# colours to go with.
_GLOSS = ((0.3, 1.0, 0.1), (0.8, 1.0, 0.3))


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

    def deviations(self) -> list[float]:
        """How far a deviation of every feature is believed to move F0, then roughness (logits)."""
        bands = len(self.features) - 2
        return [
            deviation
            for by_light, by_colour, by_band in _GLOSS
            for deviation in (
                by_light * self.lightness,
                by_colour * self.colour,
                *[by_band] * bands,
            )
        ]


def ties(diffuse: Tensor, bands: Tensor | None = None) -> Ties:
    """Features of albedo (3, H, W) and, if given, of bands of height (>= 4, H, W).

    Colour is what varies most of the channels' logarithms beside lightness.
    """
    logs = diffuse.clamp_min(_DARKEST).log()
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
    features = (stacked / spread.clamp_min(1e-6)).clamp(-_FARTHEST, _FARTHEST)
    return Ties(features, float(spread[0]), float(spread[1]))
