"""Leave-one-out error of a set: each photograph predicted from all the others.

This needs no ground truth, as maps of the others are not fitted to the photograph left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from matcap.capture.together.align import Aligned
from matcap.capture.together.solve import Solved, solve
from matcap.capture.together.texels import Estimate, log_rendered, parameters_of, points_of
from matcap.capture.together.views import ResampledView, light_at

# Settings of the leave-one-out solves; docs/notes/several.md.
_ACROSS = 224  # texels across the grid, enough for errors of shading and gloss
# Steps per texel in each round with all photographs, and from there without one; a round begins
# with a fit of the shared parameters.
_ROUNDS, _WITHOUT = (2, 1), (1,)
# Texels to which shared parameters are fitted; few, as the initial light is nearly exact.
_SAMPLED = 1500


@torch.no_grad()
def leave_one_out(
    alignment: Aligned,
    prediction: Estimate,
    solved: Solved,
    tint: Tensor | None = None,
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Predict every flash photograph from all others.

    A photograph's gain is left out of its own prediction; its registration is not, nor is the
    network's prediction of the first.

    Args:
        alignment: registration of the photographs.
        prediction: the network's.
        solved: solution by all, whose light is the initial value.
        tint: (3, H, W) specular tint of metal (tint.py), or None.

    Returns:
        Median absolute differences of log radiance of each photograph, after a fit of gain and
        white balance, from renderings of maps on the same coarse grid: estimated from all others,
        NaN without flash; and estimated from all. With fewer than two flash photographs, none, and
        those of `solved`.
    """
    width, height = prediction.maps.size
    across = min(alignment.extent.across(_ACROSS), width)
    down = max(8, round(height * across / width))
    small = prediction.resized((down, across), alignment.extent)
    views = alignment.on_grid(across, down, tint)
    if sum(view.flash for view in views) < 2:
        return (), solved.residual

    def by(kept: Sequence[int], begun: Solved | None = None) -> Solved:
        light = (begun or solved).light.of_some(kept)
        rounds = _WITHOUT if begun else _ROUNDS
        some = [views[k] for k in kept]
        return solve(some, small, light, begun, rounds=rounds, sampled=_SAMPLED)

    every = list(range(len(views)))
    whole = by(every)
    ahead, own = [math.nan] * len(views), list(solved.residual)
    for index, view in enumerate(views):
        if view.flash:
            others = [k for k in every if k != index]
            ahead[index] = left_out_residual(view, by(others, whole))
            residual = left_out_residual(view, whole)
            own[index] = own[index] if math.isnan(residual) else residual
    return tuple(ahead), tuple(own)


def left_out_residual(view: ResampledView, solved: Solved) -> float:
    """Median absolute residual of log radiance of a photograph not used for the maps.

    Each channel's gain is fitted to it first. NaN without valid texels.
    """
    points = points_of(view.log.shape[-2:], extent=view.extent)
    light = light_at(0, view, replace(solved.light, gain=torch.zeros(1, 3)), points)
    (shown,) = log_rendered(parameters_of(solved.maps), [light])
    off = view.log - shown
    for channel in range(3):
        residual = off[channel][view.seen[channel]]
        if residual.numel():
            off[channel] -= residual.median()
    residual = off[view.seen]
    return float(residual.abs().median()) if residual.numel() else math.nan
