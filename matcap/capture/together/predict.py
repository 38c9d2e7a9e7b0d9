"""Leave-one-out error of a set: each photograph predicted from all the others.

This needs no ground truth, as maps of the others are not fitted to the photograph left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.capture.together.align import Aligned
from matcap.capture.together.readings import ReadView, fewer, joined
from matcap.capture.together.solve import Solved, predicted, solve

# Settings of the leave-one-out solves; docs/notes/several.md.
_ACROSS = 224  # texels across the grid, enough for errors of shading and gloss
# Steps per texel in each round; a round begins with a fit of the shared parameters.
_ROUNDS = (2, 1)
# Texels to which shared parameters are fitted; few, as the initial light is nearly exact.
_SAMPLED = 1500


@dataclass(frozen=True)
class Predictions:
    """Leave-one-out prediction errors and residuals, (photographs,) each.

    Median absolute differences of log radiance after a fit of gain and white balance, with maps
    estimated on the same coarse grid. NaN for a photograph without flash.
    """

    predicted: tuple[float, ...]
    """Error of each in a rendering of maps estimated from all others."""
    residual: tuple[float, ...]
    """Error of each in a rendering of maps estimated from all photographs."""


@torch.no_grad()
def predictions(
    alignment: Aligned,
    readings: Sequence[ReadView | None],
    solved: Solved,
    tint: Tensor | None = None,
) -> Predictions | None:
    """Predict every flash photograph from all others; None with fewer than two.

    A photograph's gain and network prediction are left out of its own prediction; its registration
    is not.

    Args:
        alignment: registration of the photographs.
        readings: network prediction of each (readings.py).
        solved: solution by all, whose light is the initial value.
        tint: (3, H, W) specular tint of metal (tint.py), or None.
    """
    first = next(read for read in readings if read is not None)
    height, width = first.parameters.shape[1:]
    across = min(alignment.extent.across(_ACROSS), width)
    down = max(8, round(height * across / width))
    few = fewer(readings, (down, across))
    views = alignment.on_grid(across, down, tint)
    if sum(view.ambient is None for view in views) < 2:
        return None

    def by(kept: Sequence[int]) -> Solved:
        read = [few[k] for k in kept]
        # A single photograph without a prediction, for its tilt, gets those of all.
        prior = joined(read if any(read) else few)
        return solve(
            [views[k] for k in kept],
            prior,
            solved.light.of_some(kept),
            rounds=_ROUNDS,
            sampled=_SAMPLED,
        )

    every = list(range(len(views)))
    whole = by(every)
    ahead, own = [], []
    for index, view in enumerate(views):
        lit = view.ambient is None
        own.append(predicted(view, whole) if lit else math.nan)
        others = [k for k in every if k != index]
        ahead.append(predicted(view, by(others)) if lit else math.nan)
    return Predictions(tuple(ahead), tuple(own))
