"""Leave-one-out error of a set: each photograph predicted from all the others.

This needs no ground truth, as maps of the others are not fitted to the photograph left out.
"""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from matcap.capture.multiview.align import Aligned
from matcap.capture.multiview.solve import Solved, solve
from matcap.capture.multiview.texels import Estimate, log_rendered, parameters_of, points_of
from matcap.capture.multiview.views import ResampledView, light_at

# Settings of the leave-one-out solves; docs/notes/several.md.
_ACROSS = 224  # texels across the grid, enough for errors of shading and gloss
# Steps per texel in each round (solve.ROUNDS): of the solution by all photographs, which starts
# from the prediction, and of those without one photograph, which start from that solution.
_ROUNDS, _WITHOUT = (2, 1), (1,)
# Texels to which shared parameters are fitted; few, as the initial light is nearly exact.
_SAMPLED = 1500


@torch.no_grad()
def leave_one_out(
    alignment: Aligned,
    prediction: Estimate,
    solved: Solved,
    tint: Tensor,
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Predict every flash photograph from all others.

    The solution without a photograph starts from the registration of all, and from the network's
    prediction of the first photograph, even if that is the one left out. The photograph's gain is
    fitted to it.

    Args:
        alignment: registration of the photographs.
        prediction: the network's.
        solved: solution by all, whose light is the initial value.
        tint: (1 or 3, H, W) specular tint (tint.py).

    Returns:
        Two medians of |log radiance of photograph - rendering| for each photograph, on one coarse
        grid: of maps estimated from all others, NaN without flash; and of maps estimated from all.
        With fewer than two flash photographs, nothing, and the residuals of `solved`.
    """
    width, height = prediction.maps.size
    across = min(alignment.extent.across(_ACROSS), width)
    down = round(height * across / width)
    small = prediction.resized((down, across), alignment.extent)
    views = alignment.on_grid(across, down, tint)
    lit = [number for number, view in enumerate(views) if view.flash]
    if len(lit) < 2:
        return (), solved.residual
    light = solved.light.of_some(range(len(views)))
    by_all = solve(views, small, light, rounds=_ROUNDS, sampled=_SAMPLED)
    predicted, residuals = [math.nan] * len(views), list(solved.residual)
    for left_out in lit:
        kept = [number for number in range(len(views)) if number != left_out]
        some, light = [views[number] for number in kept], by_all.light.of_some(kept)
        by_others = solve(some, small, light, by_all, rounds=_WITHOUT, sampled=_SAMPLED)
        predicted[left_out] = left_out_residual(views[left_out], by_others)
        residual = left_out_residual(views[left_out], by_all)
        residuals[left_out] = residuals[left_out] if math.isnan(residual) else residual
    return tuple(predicted), tuple(residuals)


def left_out_residual(view: ResampledView, solved: Solved) -> float:
    """Median absolute residual of log radiance of a photograph not used for the maps.

    Each channel's gain is fitted to it first. NaN without valid texels.
    """
    points = points_of(view.log.shape[-2:], extent=view.extent)
    light = light_at(0, view, replace(solved.light, gain=torch.zeros(1, 3)), points)
    (rendered,) = log_rendered(parameters_of(solved.maps), [light])
    residual = view.log - rendered
    for channel in range(3):
        valid = residual[channel][view.seen[channel]]
        if valid.numel():
            residual[channel] -= valid.median()
    valid = residual[view.seen]
    return float(valid.abs().median()) if valid.numel() else math.nan
