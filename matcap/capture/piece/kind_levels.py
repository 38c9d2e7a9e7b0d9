"""Levels of two uniform kinds, by how the brightness of each falls off around the flash's foot.

Means in rings: relief that is read right in strength and wrong in place still spreads light
rightly, and few texels around the foot count as much as many beyond. Both photograph and kinds are
clipped, so that what is burnt out counts as far as it reaches. Rings of one kind hold some of the
other where texels are shared, and are predicted so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from matcap.brdf.parameters import SurfaceParameters
from matcap.capture.piece.absolute import SCALE
from matcap.capture.piece.metal import whole_colour
from matcap.capture.piece.tuned import KINDS
from matcap.flash.light import FlashLight

DARKEST = 1e-5  # radiance
LEVELS = 5  # of a kind, as SurfaceParameters.levels has them
_SPECULAR = 3  # where F0 is among levels
_STEP = 0.03  # of logit roughness, for differences


@dataclass(frozen=True)
class ShownKinds:
    """A photograph of two kinds.

    Attributes:
        linear: (3, H, W) radiance on the plane's grid; 1 is where it clips.
        measured: (3, H, W) bool: not clipped.
        counts: (H, W) bool: what lies in the picture, clipped or not.
        away: (H, W) plane units from where a mirror would show the flash.
        flash: the photograph's.
        normal: (3, H, W) of the relief as read.
        uniform: what levels depart from.
        hue: (3, 1, 1) or one number: of metal's F0, channels' mean 1.
    """

    linear: Tensor
    measured: Tensor
    counts: Tensor
    away: Tensor
    flash: FlashLight
    normal: Tensor
    uniform: SurfaceParameters
    hue: Tensor | float = 1.0

    def thinned(self, step: int) -> ShownKinds:
        """One texel of so many a side."""
        every = slice(None, None, step)
        planes = ("linear", "measured", "counts", "away", "normal")
        thin = {name: getattr(self, name)[..., every, every] for name in planes}
        return replace(self, flash=self.flash.cut(every, every), **thin)

    def coloured(self, metal: Tensor) -> ShownKinds:
        """Metal's hue as it is seen where metal (1, H, W) is."""
        seen = metal * self.measured.all(0, keepdim=True) * self.counts
        return replace(self, hue=whole_colour(self.linear, seen))

    def rendered(self, levels: Tensor, duller: float = 0.0) -> list[tuple[Tensor, Tensor]]:
        """Diffuse and mirrored radiance (3, H, W) of metal and of the rest, each everywhere.

        Args:
            levels: (2, 5), departures from the uniform material.
            duller: added to the logit of roughness.
        """
        incidence = self.flash.onto(self.normal)
        one = torch.ones_like(self.away)[None]
        parts = []
        for level, hue in zip(levels, (self.hue, 1.0), strict=True):
            surface = self.uniform + SurfaceParameters.from_levels(level)
            roughness = torch.sigmoid(surface.roughness + duller)
            parts.append(
                (
                    incidence.diffuse(surface.diffuse.exp() * one),
                    incidence.specular(surface.specular.exp() * hue * one, roughness * one),
                )
            )
        return parts


class _Rings:
    """Means of both kinds in rings."""

    def __init__(self, shown: ShownKinds, metal: Tensor) -> None:
        ring = (shown.away / KINDS.ring).long()
        self._ring = ring.flatten()
        self._many = int(ring.max()) + 1
        self.weights = [(kind[0] * shown.counts).flatten() for kind in (metal, 1.0 - metal)]
        sums = torch.stack([self._sums(weight) for weight in self.weights])
        self._sizes = sums.clamp_min(1e-6)
        self.counts = (sums / (sums + KINDS.ring_texels))[:, None].expand(-1, 3, -1)

    def _sums(self, weight: Tensor) -> Tensor:
        return torch.bincount(self._ring, weight, self._many)

    def means(self, picture: Tensor) -> Tensor:
        """(2, C, rings) of a picture (C, H, W)."""
        flat = picture.flatten(1)
        return torch.stack(
            [
                torch.stack([self._sums(channel * weight) for channel in flat]) / size
                for weight, size in zip(self.weights, self._sizes, strict=True)
            ]
        )


def fitted(shown: ShownKinds, metal: Tensor, levels: Tensor, read: Tensor) -> tuple[Tensor, float]:
    """(2, 5) levels whose rings are the photograph's, and by how much their logarithms are off.

    Gauss-Newton, robust; what rings do not tell stays as it was read, and F0 of metal is believed
    to be as much above the rest's as materials' are (absolute.py).

    Args:
        shown: the photograph.
        metal: (1, H, W) share that is metal.
        levels: (2, 5) to begin with.
        read: (2, 5) as the network has them.
    """
    rings = _Rings(shown, metal)
    observed = rings.means(shown.linear.clamp_max(1.0)).clamp_min(DARKEST).log()
    doubts = [*[KINDS.albedo] * 3, KINDS.specular, KINDS.roughness] * 2
    prior = torch.tensor(doubts).square().reciprocal()
    apart, wanted, belief = _apart()
    for _ in range(KINDS.steps):
        residual, columns = _linear(shown, rings, metal, levels, observed)
        counts = rings.counts.flatten() / KINDS.noise**2
        robust = KINDS.huber / residual.abs().clamp_min(KINDS.huber)
        weighted = columns * (counts * robust)
        off = apart @ levels.flatten()
        normal = weighted @ columns.T + torch.diag(prior) + belief * apart[:, None] * apart
        gradient = weighted @ residual - prior * (levels - read).flatten()
        gradient += belief * (wanted - off) * apart
        step = torch.linalg.solve(normal, gradient).clamp(-KINDS.most, KINDS.most)
        levels = levels + step.reshape(levels.shape)
    residual, _ = _linear(shown, rings, metal, levels, observed)
    counts = rings.counts.flatten()
    return levels, float((residual.abs() * counts).sum() / counts.sum())


def _apart() -> tuple[Tensor, float, float]:
    """(10,) what of levels is log F0 of metal over the rest's; how much that is; its precision."""
    plain, metal = SCALE.kinds
    apart = torch.zeros(2, LEVELS)
    apart[:, _SPECULAR] = torch.tensor([1.0, -1.0])
    doubt = math.hypot(plain.specular[1], metal.specular[1])
    return apart.flatten(), metal.specular[0] - plain.specular[0], doubt**-2


def _linear(
    shown: ShownKinds, rings: _Rings, metal: Tensor, levels: Tensor, observed: Tensor
) -> tuple[Tensor, Tensor]:
    """(N,) residuals of rings' log radiance, and (10, N) what these change by with levels."""
    parts = shown.rendered(levels)
    duller = shown.rendered(levels, _STEP)
    shares = (metal, 1.0 - metal)
    bare, rest = (diffuse + mirrored for diffuse, mirrored in parts)
    mixed = metal * bare + (1.0 - metal) * rest
    mean = rings.means(mixed.clamp_max(1.0)).clamp_min(DARKEST)
    below = mixed < 1.0
    columns = []
    for share, (diffuse, mirrored), (_, moved) in zip(shares, parts, duller, strict=True):
        shows = share * below
        by_albedo = rings.means(shows * diffuse) / mean
        for channel in range(3):
            own = torch.zeros_like(by_albedo)
            own[:, channel] = by_albedo[:, channel]
            columns.append(own)
        columns.append(rings.means(shows * mirrored) / mean)
        columns.append(rings.means(shows * (moved - mirrored) / _STEP) / mean)
    return (observed - mean.log()).flatten(), torch.stack(columns).flatten(1)
