"""Whether a blend passes through materials: how far its middle is from any photograph.

Pairs of held-out photographs are blended untuned, as they lie in the space. A picture's distance
from photographs is the style distance to the nearest of them; a middle that is
no material is farther from all of them than the ends of its blend are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from matcap.lab.measures.style import StyleStatistics
from matcap.lab.measures.variety import describe_pictures, style_distances
from matcap.lab.train.pack import Entry
from matcap.lab.train.pictures import lit
from matcap.space.between import blend
from matcap.space.prior.store import Prior

PAIRS = 10
_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
_MIDDLE = 2  # of the shares


@dataclass(frozen=True)
class Middle:
    """One blend.

    Attributes:
        first, second: materials at its ends.
        ends: mean style distance of both ends to their nearest photographs.
        middle: of the middle to its own.
        strip: (3, size, 5 size) sRGB, the blend in five steps.
    """

    first: str
    second: str
    ends: float
    middle: float
    strip: Tensor

    @property
    def ratio(self) -> float:
        """Of the middle's distance to the ends'."""
        return self.middle / self.ends


def middles(prior: Prior, entries: Sequence[Entry], photographs: StyleStatistics) -> list[Middle]:
    """Blends of neighbours in a list of photographs of different materials, at most PAIRS.

    Args:
        prior: the space.
        entries: photographs whose places are blended.
        photographs: statistics of those that pictures are compared with.
    """
    places = [prior.place(entry.photo()) for entry in entries[: PAIRS + 1]]
    materials = [prior.draw(0, near=place, spread=0.0) for place in places]
    found = []
    for index in range(len(materials) - 1):
        first, second = materials[index : index + 2]
        steps = [lit(blend(first, second, share)) for share in _SHARES]
        nearest = style_distances(describe_pictures(steps), photographs).min(dim=1).values
        found.append(
            Middle(
                entries[index].material,
                entries[index + 1].material,
                float(nearest[[0, -1]].mean()),
                float(nearest[_MIDDLE]),
                torch.cat(steps, dim=2),
            )
        )
    return found
