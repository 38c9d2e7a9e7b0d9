"""The sweep of plain materials' gloss."""

import numpy as np
import pytest

from matcap.lab.bench.gloss import GlossRow, PlainMaterial, gloss_markdown, run_gloss

SATIN = PlainMaterial((0.3, 0.2, 0.15), 0.04, 0.2, 0.0)


@pytest.mark.parametrize("size", [(256, 192), (512, 384)])
def test_bumps_are_as_steep_as_asked_for_at_any_detail(size):
    maps = PlainMaterial((0.3, 0.2, 0.15), 0.04, 0.2, 0.1).realise(*size, 2.0 / size[0])
    down, across = np.gradient(maps.height[0].numpy() / maps.texel_size)
    assert np.sqrt((down**2 + across**2).mean()) == pytest.approx(0.1, rel=1e-3)


def test_polish_is_told_though_two_stops_of_its_highlight_are_clipped():
    whole, clipped = run_gloss(iter([SATIN]), (0, 2))
    assert clipped.clipped > 2.0 * whole.clipped
    assert whole.roughness == pytest.approx(0.2, abs=0.05)
    assert clipped.roughness == pytest.approx(0.2, abs=0.05)


def test_the_table_counts_what_is_near():
    rows = [GlossRow(SATIN, 0, 0.01, 0.24, 0.04), GlossRow(SATIN, 1, 0.05, 0.4, 0.04)]
    table = gloss_markdown(rows, "matcap bench gloss")
    assert "| 0 | 0.3 | 0.04 | 0.2 | 0.24, 0.040 (1 %) | 0.40, 0.040 (5 %) |" in table
    assert "within 0.05: 1 of 1 at +0, 0 of 1 at +1." in table
