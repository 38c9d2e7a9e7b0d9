"""Advice for a clipped highlight: how many stops darker another exposure is to be."""

from __future__ import annotations

import pytest

from matcap.capture.inspection import _darker
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.geometry import FlashSetup


def fit(intensity: float, roughness: float = 0.2) -> CoarseFit:
    setup = FlashSetup(fov=66.0).with_intensity((intensity,) * 3)
    return CoarseFit((0.2, 0.2, 0.2), 0.04, roughness, setup, residual=0.1)


def stops(advice: str) -> int:
    return int(advice.split(" stops")[0].rsplit(" ", 1)[1])


def test_the_brighter_the_highlight_the_darker_the_exposure():
    advised = [stops(_darker(fit(intensity), 1.0)) for intensity in (0.01, 0.3, 1.0, 4.0, 1000.0)]
    assert (
        advised == sorted(advised)
        and advised[0] == 2
        and advised[-1] == 6
        and len(set(advised)) >= 3
    )
    assert stops(_darker(fit(4.0), 4.0)) == stops(_darker(fit(1.0), 1.0))


@pytest.mark.parametrize("roughness", [0.1, 0.5])
def test_the_advice_names_the_position(roughness):
    assert "from the same place" in _darker(fit(1.0, roughness), 1.0)
