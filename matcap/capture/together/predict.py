"""The honest error of a set: each photograph predicted from all the others.

It needs no truth: what no photograph shows but one, the others cannot have been bent to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.capture.together.align import Aligned, shrunk
from matcap.capture.together.solve import Solved, predicted, solve
from matcap.capture.together.texels import SolveSettings
from matcap.capture.together.views import PieceView


@dataclass(frozen=True)
class PredictSettings:
    """How it is found out.

    Attributes:
        across: texels; a prediction's error is that of shading and gloss, which show there.
        rounds: of solving.
    """

    across: int = 224
    rounds: tuple[int, ...] = (2, 1)


@torch.no_grad()
def predictions(
    found: Aligned,
    prior: MapSet,
    doubt: Tensor,
    solved: Solved,
    radiometric: bool,
    settings: PredictSettings | None = None,
) -> tuple[float, ...]:
    """Median difference of log radiance of each photograph from what all others make of it.

    NaN of one by the room's light, whose light nobody predicts; nothing where one flash is all.

    Args:
        found: where photographs lie.
        prior, doubt: of the first one, as for solve. It is read from the first photograph, so the
            first one's own prediction is the kinder one.
        solved: by all of them, whose light it begins with.
        radiometric: as for solve.
        settings: see there.
    """
    settings = settings or PredictSettings()
    width, height = prior.size
    across = min(settings.across, width)
    down = max(8, round(height * across / width))
    small, unsure = shrunk(prior, doubt, (down, across))
    views = [
        PieceView.of(view, across, down, place)
        for view, place in zip(found.views, found.places, strict=True)
    ]
    solving = SolveSettings(rounds=settings.rounds)
    errors = []
    if sum(view.room is None for view in views) < 2:
        return ()
    for index, view in enumerate(views):
        if view.room is not None:
            errors.append(math.nan)
            continue
        kept = [k for k in range(len(views)) if k != index]
        light = solved.light.of_some(kept)
        by_others = solve(
            [views[k] for k in kept],
            small,
            unsure,
            light,
            radiometric=radiometric,
            settings=solving,
        )
        errors.append(predicted(view, replace(by_others, light=by_others.light)))
    return tuple(errors)
