"""What maps pay: of an F0 with a colour as much as of its mean."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.space.tuning.penalty import Penalties, price

COPPER = torch.tensor([0.955, 0.638, 0.538])[:, None, None]


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_coloured_f0_pays_what_its_mean_does(share: float) -> None:
    draw = torch.rand(2, 6, 16, 24, generator=torch.Generator().manual_seed(1)) * 0.5 + 0.2
    grey = MapSet.from_stacked(draw, 0.1)
    coloured = replace(grey, specular=grey.specular * COPPER / COPPER.mean())
    expected = torch.zeros(5)
    paid, owed = (price(m, expected, Penalties(), share) for m in (coloured, grey))
    assert float(paid) == pytest.approx(float(owed), rel=1e-5)
    assert float(paid) > 0.0
