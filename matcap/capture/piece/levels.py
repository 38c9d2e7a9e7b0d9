"""Albedo, F0 and roughness of material classes, from the profile of the highlight.

For rings i of texels around the mirror point (where a mirror would show the flash), the logarithm
of the mean radiance of each class k is compared with the photograph's:

    log mean_i(w_k L) = log mean_i(w_k sum_k w_k L(theta_k)) + noise

by robust least squares over the levels theta_k = (log albedo 3, log F0, logit roughness), with a
Gaussian prior. The relief is in L: a highlight's width is roughness and the slopes under it. Ring
means do not ask relief to be in the right place, only to have the right strength, and few texels at
the mirror point count as much as many beyond. A ring of which part is clipped is a lower bound: its
glints were brighter than they look, and comparing clipped means would take them for roughness.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from matcap.brdf.parameters import SurfaceParameters
from matcap.flash.light import FlashLight, Incidence

DARKEST = 1e-5  # radiance
_STEP = 0.03  # of logit roughness, for differences


@dataclass(frozen=True)
class LevelSettings:
    """What is tuned of the fit.

    Attributes:
        innermost: plane units, radius of the first rings; beyond, rings widen with their radius.
        per_octave: rings an octave of radius.
        ring_texels: of a class in a ring, at which it counts half.
        clipped: share of a ring that is clipped, at which it is a lower bound only.
        noise, huber: of a ring's log radiance: deviation, and beyond which it counts linearly.
        most: that a level moves in a step.
        steps: of Gauss-Newton.
        texels: along the short side that levels are fitted on.
    """

    innermost: float = 0.02
    per_octave: float = 4.0
    ring_texels: float = 50.0
    clipped: float = 0.05
    noise: float = 0.1
    huber: float = 0.3
    most: float = 0.4
    steps: int = 16
    texels: int = 384


@dataclass(frozen=True)
class LevelPrior:
    """Gaussian prior of levels.

    Attributes:
        mean, deviation: (K, 5).
        contrast: mean and deviation of log F0 of the first class over the second's, or None.
    """

    mean: Tensor
    deviation: Tensor
    contrast: tuple[float, float] | None = None


@dataclass(frozen=True)
class RingTarget:
    """A photograph, and what is known of the surface in it.

    Attributes:
        linear: (3, H, W) radiance on the plane's grid; 1 is where it clips.
        measured: (3, H, W) bool: not clipped.
        counts: (H, W) bool: what lies in the picture, clipped or not.
        distance: (H, W) plane units from the mirror point.
        flash: the photograph's.
        normal: (3, H, W) of the relief.
        surface: what levels are added to; broadcasts to (..., H, W).
        hues: F0 over the mean of its channels of every class: (3, 1, 1) or one number.
    """

    linear: Tensor
    measured: Tensor
    counts: Tensor
    distance: Tensor
    flash: FlashLight
    normal: Tensor
    surface: SurfaceParameters
    hues: tuple[Tensor | float, ...] = (1.0,)

    def thinned(self, texels: int) -> RingTarget:
        """One texel of several, so that so many are left along the short side."""
        size = self.distance.shape
        every = slice(None, None, max(1, min(size) // texels))

        def thin(plane: Tensor) -> Tensor:
            return plane[..., every, every] if plane.shape[-2:] == size else plane

        planes = ("linear", "measured", "counts", "distance", "normal")
        parts = (getattr(self.surface, each.name) for each in fields(SurfaceParameters))
        return replace(
            self,
            **{name: thin(getattr(self, name)) for name in planes},
            flash=self.flash.cut(every, every),
            surface=SurfaceParameters(*(thin(part) for part in parts)),
            hues=tuple(thin(hue) if isinstance(hue, Tensor) else hue for hue in self.hues),
        )

    def rendered(
        self, levels: Tensor, incidence: Incidence, duller: float = 0.0
    ) -> list[tuple[Tensor, Tensor]]:
        """Diffuse and specular radiance (3, H, W) of each class, everywhere.

        Args:
            levels: (K, 5), added to the surface.
            incidence: on the relief.
            duller: added to the logit of roughness.
        """
        one = torch.ones_like(self.distance)[None]
        parts = []
        for level, hue in zip(levels, self.hues, strict=True):
            surface = self.surface + SurfaceParameters.from_levels(level)
            roughness = torch.sigmoid(surface.roughness + duller)
            parts.append(
                (
                    incidence.diffuse(surface.diffuse.exp() * one),
                    incidence.specular(surface.specular.exp() * hue * one, roughness * one),
                )
            )
        return parts


class _Rings:
    """Means of every class in rings."""

    def __init__(self, target: RingTarget, shares: Tensor, settings: LevelSettings) -> None:
        octaves = torch.log2(1.0 + target.distance / settings.innermost)
        self._ring = (settings.per_octave * octaves).long().flatten()
        self._many = int(self._ring.max()) + 1
        self._weights = [(share * target.counts).flatten() for share in shares]
        sums = torch.stack([self._sums(weight) for weight in self._weights])
        self._sizes = sums.clamp_min(1e-6)
        self.counts = (sums / (sums + settings.ring_texels))[:, None].expand(-1, 3, -1)

    def _sums(self, weight: Tensor) -> Tensor:
        return torch.bincount(self._ring, weight, self._many)

    def means(self, picture: Tensor) -> Tensor:
        """(K, C, rings) of a picture (C, H, W)."""
        flat = picture.flatten(1)
        return torch.stack(
            [
                torch.stack([self._sums(channel * weight) for channel in flat]) / size
                for weight, size in zip(self._weights, self._sizes, strict=True)
            ]
        )


def fit_levels(
    target: RingTarget,
    shares: Tensor,
    start: Tensor,
    prior: LevelPrior,
    settings: LevelSettings | None = None,
) -> tuple[Tensor, float]:
    """(K, 5) levels whose ring means are the photograph's, and the mean absolute log residual.

    Args:
        target: the photograph.
        shares: (K, H, W) of every texel that belongs to a class; they sum to 1.
        start: (K, 5) to begin with.
        prior: of levels.
        settings: of the fit.
    """
    settings = settings or LevelSettings()
    rings = _Rings(target, shares, settings)
    observed = rings.means(target.linear.clamp_max(1.0)).clamp_min(DARKEST).log()
    incidence = target.flash.onto(target.normal)
    precision = prior.deviation.flatten().square().reciprocal()
    contrast = torch.zeros_like(start)
    wanted, belief = 0.0, 0.0
    if prior.contrast is not None:
        contrast[0, 3], contrast[1, 3] = 1.0, -1.0
        wanted, belief = prior.contrast[0], prior.contrast[1] ** -2
    across = contrast.flatten()
    counts = rings.counts.flatten() / settings.noise**2
    open_share = 1.0 - rings.means((~target.measured).float()).flatten() / settings.clipped
    bound = open_share.clamp(0.0, 1.0)
    levels = start
    for _ in range(settings.steps):
        residual, columns = _linear(target, incidence, rings, shares, levels, observed)
        robust = settings.huber / residual.abs().clamp_min(settings.huber)
        robust = torch.where(residual < 0.0, bound * robust, robust)
        weighted = columns * (counts * robust)
        normal = weighted @ columns.T + torch.diag(precision) + belief * across[:, None] * across
        gradient = weighted @ residual - precision * (levels - prior.mean).flatten()
        gradient += belief * (wanted - across @ levels.flatten()) * across
        step = torch.linalg.solve(normal, gradient).clamp(-settings.most, settings.most)
        levels = levels + step.reshape(levels.shape)
    residual, _ = _linear(target, incidence, rings, shares, levels, observed)
    counts = counts * torch.where(residual < 0.0, bound, 1.0)
    return levels, float((residual.abs() * counts).sum() / counts.sum())


def _linear(
    target: RingTarget,
    incidence: Incidence,
    rings: _Rings,
    shares: Tensor,
    levels: Tensor,
    observed: Tensor,
) -> tuple[Tensor, Tensor]:
    """(N,) residuals of rings' log radiance, and (5 K, N) what these change by with levels."""
    parts = target.rendered(levels, incidence)
    duller = target.rendered(levels, incidence, _STEP)
    mixed = sum(share * (d + s) for share, (d, s) in zip(shares, parts, strict=True))
    assert isinstance(mixed, Tensor)
    mean = rings.means(mixed).clamp_min(DARKEST)
    columns = []
    for share, (diffuse, specular), (_, moved) in zip(shares, parts, duller, strict=True):
        by_albedo = rings.means(share * diffuse) / mean
        for channel in range(3):
            own = torch.zeros_like(by_albedo)
            own[:, channel] = by_albedo[:, channel]
            columns.append(own)
        columns.append(rings.means(share * specular) / mean)
        columns.append(rings.means(share * (moved - specular) / _STEP) / mean)
    return (observed - mean.log()).flatten(), torch.stack(columns).flatten(1)
