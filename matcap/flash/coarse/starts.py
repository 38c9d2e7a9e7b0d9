"""Initial values of the coarse fit, several because of local minima, and the choice between minima.

Roughness starts at four values, or at those that the highlight's width means; the place of the
highlight is the flash's offset or the plane's tilt: both are tried.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from matcap.flash.coarse.hypotheses import Hypothesis
from matcap.flash.coarse.model import Unknowns, numbers
from matcap.flash.highlight import Highlight

# Logit of roughness: matte, satin, glossy, mirror-like.
_STARTS = (0.8, -0.4, -1.4, -2.2)
# Multiples of the roughness that a highlight's width means: clipping widens it.
_WIDTHS = (1.0, 0.6)
_MATTE = 2.5  # logit of roughness
# GGX is half its peak where the half vector's tangent is this many alpha.
_HALF_GGX = 0.644
_DISTINCT = 0.3  # starts whose logits of roughness differ by less are duplicates
# Root-mean-square log radiance by which a fit may be worse and count as equal.
_ALIKE = 0.003


def starts(
    observed: Tensor, prior: Hypothesis, highlight: Highlight | None, distance: float
) -> Iterable[Tensor]:
    """Starting points whose brightness and hue already fit the photograph's median.

    Radiance there is about albedo / pi intensity / distance^2; a conductor's is darker, away from
    its highlight.
    """
    mean = prior.mean
    median = observed.median(dim=1).values
    brightness = median.mean()
    intensity = brightness - mean.albedo[:1] + math.log(math.pi) + 2.0
    logits, places = list(_STARTS), [mean]
    if highlight is not None:
        alpha = min(highlight.width / (_HALF_GGX * distance), 0.6)
        means = math.sqrt(alpha)
        logits = [_STARTS[0]]
        logits += [math.log(share * means / (1.0 - share * means)) for share in _WIDTHS]
        u, v = highlight.centre
        tilt_x, tilt_y = mean.tilt.tolist()
        across, up = u + distance * math.tan(tilt_y), v - distance * math.tan(tilt_x)
        shifted = replace(mean, offset=numbers(2.0 * across, 2.0 * up))
        turned = replace(mean, tilt=numbers(v / distance, -u / distance))
        places = [shifted] if prior.tilt_known else [shifted, turned]
    for place in places:
        for logit in logits:
            yield replace(
                place,
                albedo=mean.albedo + (median - brightness),
                roughness=numbers(logit),
                intensity=intensity + (1.5 if prior.conductor else 0.0),
            ).vector()


def distinct(fits: Sequence[Tensor]) -> list[Tensor]:
    """Parameters, the best first, without those of nearly the same roughness as better ones."""
    kept: list[Tensor] = []
    for candidate in fits:
        own = _roughness(candidate)
        if all(abs(own - _roughness(one)) > _DISTINCT for one in kept):
            kept.append(candidate)
    return kept


def matte(candidate: Tensor) -> Tensor:
    """Parameters with roughness set near 1, for a matte starting point."""
    unknowns = Unknowns.of(candidate)
    return replace(unknowns, roughness=torch.full_like(unknowns.roughness, _MATTE)).vector()


def mattest(fits: Sequence[tuple[float, Tensor]]) -> Tensor:
    """The roughest among fits (cost, parameters) of nearly equal cost, so that no highlight is
    invented in clipped areas.
    """
    least = min(cost for cost, _ in fits)
    alike = [candidate for cost, candidate in fits if cost <= least + 0.5 * _ALIKE**2]
    return max(alike, key=_roughness)


def _roughness(parameters: Tensor) -> float:
    """Logit of roughness."""
    return float(Unknowns.of(parameters).roughness)
