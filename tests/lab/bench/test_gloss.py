"""The sweep of plain materials' gloss."""

import numpy as np
import pytest

from matcap.lab.bench.gloss import PlainMaterial, gloss_experiment
from matcap.lab.experiment.runner import run
from matcap.lab.simulate.photograph import PhoneCamera

SATIN = PlainMaterial((0.3, 0.2, 0.15), 0.04, 0.2, 0.0)


@pytest.mark.parametrize("size", [(256, 192), (512, 384)])
def test_bumps_are_as_steep_as_asked_for_at_any_detail(size):
    maps = PlainMaterial((0.3, 0.2, 0.15), 0.04, 0.2, 0.1).realise(*size, 2.0 / size[0])
    down, across = np.gradient(maps.height[0].numpy() / maps.texel_size)
    assert np.sqrt((down**2 + across**2).mean()) == pytest.approx(0.1, rel=1e-3)


def test_polish_is_found_though_two_stops_of_its_highlight_are_clipped(tmp_path):
    camera = PhoneCamera(800, 600, supersampling=1)
    experiment = gloss_experiment(iter([SATIN]), (0, 2), camera=camera)
    whole, clipped = run(experiment, tmp_path / "gloss.csv")
    assert clipped.number("clipped") > 2.0 * whole.number("clipped")
    assert (whole.configuration, whole.subject) == ("+0 EV", "0, 0.3, 0.04, 0.2")
    for row in (whole, clipped):
        assert row.number("roughness") == pytest.approx(0.2, abs=0.05)
        assert row.number("near") == 1.0
