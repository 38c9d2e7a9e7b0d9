"""Metal beside what is none: two kinds, with levels of their own that the photograph decides.

A network that doubts which of two kinds a texel is answers what lies between both everywhere: F0 of
0.1 for bare steel and for its rust. What a photograph shows of a kind is how its brightness falls
off around the flash's foot: metal flares there and is black beyond, what is none hardly changes.
So each kind is taken for uniform and fitted to that (kind_levels.py). Which texel is of which kind
begins with what the network drew, and is told anew by which kind's radiance is nearer: expectation
and maximisation (Dempster, Laird and Rubin 1977).

Where all is metal, or none, the two do not come out as metal and none, and are not believed.
docs/notes/metal.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from torch import Tensor

from matcap.brdf.parameters import REFLECTANCE, SurfaceParameters
from matcap.capture.piece.absolute import how_metallic
from matcap.capture.piece.kind_levels import DARKEST, ShownKinds, fitted
from matcap.capture.piece.smooth import smoothed
from matcap.capture.piece.tuned import KINDS


@dataclass(frozen=True)
class Kinds:
    """Metal and the rest.

    Attributes:
        metal: (1, H, W) share of each texel that is metal.
        levels: (2, 5) of metal and of the rest, departures from the coarse fit.
        off: mean difference of log radiance of their rings from the photograph's.
        agreed: correlation of what texels' radiance tells of their kind with what was drawn.
    """

    metal: Tensor
    levels: Tensor
    off: float
    agreed: float

    def departures(self) -> SurfaceParameters:
        """Of the two uniform kinds, flat."""
        bare, rest = (SurfaceParameters.from_levels(level) for level in self.levels)
        mixed = {
            name: self.metal * getattr(bare, name) + (1.0 - self.metal) * getattr(rest, name)
            for name in REFLECTANCE
        }
        return SurfaceParameters(**mixed, height=torch.zeros_like(self.metal))

    def told(self, departures: SurfaceParameters) -> SurfaceParameters:
        """Departures whose means over both kinds are the kinds' levels."""
        read = replace(self, levels=_means(departures, self.metal))
        return departures - read.departures() + self.departures()

    def believed(self, uniform: SurfaceParameters) -> bool:
        """Whether one most probably is metal and the other none, and both explain the photograph.

        Args:
            uniform: what levels depart from.
        """
        bare, rest = (how_metallic(uniform.levels() + level) for level in self.levels)
        share = float(self.metal.mean())
        return (
            min(share, 1.0 - share) > KINDS.least_share
            and min(bare, -rest) > KINDS.sure
            and self.off < KINDS.most_off
            and self.agreed > KINDS.agreed
        )


def two_kinds(departures: SurfaceParameters, logit: Tensor, shown: ShownKinds) -> Kinds:
    """The most probable two kinds.

    Args:
        departures: of the piece, as read.
        logit: (1, H, W) of metal, as read.
        shown: the photograph.
    """
    drawn = KINDS.drawn * goes_with_metal(departures, logit)
    step = max(1, min(logit.shape[-2:]) // KINDS.texels)
    few, thin = shown.thinned(step), drawn[:, ::step, ::step]
    metal = torch.sigmoid(thin)
    few = few.coloured(metal)
    read = levels = _means(departures, torch.sigmoid(drawn))
    off = 0.0
    for number in range(KINDS.rounds):
        if number:
            metal = _share(_nearer(few, levels), thin, float(metal.mean()))
            few = few.coloured(metal)
        levels, off = fitted(few, metal, levels, read)
    whole = replace(shown, hue=few.hue)
    nearer = _nearer(whole, levels)
    metal = _share(nearer, drawn, float(metal.mean()))
    both = torch.stack([nearer.flatten(), drawn.flatten()])
    agreed = float(torch.corrcoef(both)[0, 1].nan_to_num())
    return Kinds(metal, _blackened(levels, shown.uniform), off, agreed)


def goes_with_metal(departures: SurfaceParameters, logit: Tensor) -> Tensor:
    """(1, H, W) what of a reading goes with the logit of metal (1, H, W); median 0, deviation 1.

    Beside a highlight all is told to be metal and far from it little: what counts is what a texel
    differs by from its neighbourhood, in the logit and in maps that differ as it does.
    """
    albedo = departures.diffuse
    lightness = albedo.mean(0, keepdim=True)
    colour = (albedo - lightness)[::2]
    maps = [logit, lightness, colour, departures.roughness, departures.specular]
    around = max(logit.shape) / KINDS.around
    apart = np.stack([plane - smoothed(plane, around) for plane in torch.cat(maps).numpy()])
    apart /= apart.std((1, 2), keepdims=True) + np.float32(1e-6)
    together = (apart * apart[0]).mean((1, 2))
    score = np.tensordot(together * np.abs(together), apart, 1)
    score = (score - np.median(score)) / (score.std() + np.float32(1e-6))
    return torch.from_numpy(score.astype(np.float32))[None]


def _nearer(shown: ShownKinds, levels: Tensor) -> Tensor:
    """(1, H, W) log odds of metal by radiance alone: how much nearer metal's is.

    Args:
        shown: the photograph.
        levels: (2, 5) of the kinds.
    """
    observed = shown.linear.clamp_min(DARKEST).log()
    off = []
    for diffuse, mirrored in shown.rendered(levels):
        residual = observed - (diffuse + mirrored).clamp_min(DARKEST).log()
        residual = torch.where(shown.measured, residual, residual.clamp_min(0.0))
        grey = residual.mean(0, keepdim=True)
        colour = (residual - grey).square().sum(0, keepdim=True)
        # Cauchy's distribution: relief in the wrong place is far off now and then.
        tones = torch.log1p(grey.square() / KINDS.grey**2)
        off.append(tones + torch.log1p(colour / KINDS.colour**2))
    bare, rest = off
    # Of a neighbourhood: kinds lie in patches, and relief turns to and from the light.
    around = KINDS.patch * shown.linear.shape[-1]
    plane = cv2.GaussianBlur((rest - bare)[0].numpy(), (0, 0), around)
    return torch.from_numpy(KINDS.counts * plane)[None]


def _share(nearer: Tensor, drawn: Tensor, before: float) -> Tensor:
    """(1, H, W) of each texel that is metal.

    Args:
        nearer, drawn: (1, H, W) log odds, by radiance and as the network drew it.
        before: share of all that is metal.
    """
    common = min(max(before, KINDS.least_share), 1.0 - KINDS.least_share)
    return torch.sigmoid(math.log(common / (1.0 - common)) + nearer + drawn)


def _blackened(levels: Tensor, uniform: SurfaceParameters) -> Tensor:
    """Levels whose metal has as little of a diffuse albedo in all channels as in the least."""
    albedo = uniform.levels()[:3]
    black = levels.clone()
    black[0, :3] = (levels[0, :3] + albedo).min() - albedo
    return black


def _means(departures: SurfaceParameters, metal: Tensor) -> Tensor:
    """(2, 5) mean levels over metal and over the rest."""
    planes = torch.cat([getattr(departures, name) for name in REFLECTANCE])
    return torch.stack(
        [(planes * w).sum((1, 2)) / w.sum().clamp_min(1e-6) for w in (metal, 1.0 - metal)]
    )
