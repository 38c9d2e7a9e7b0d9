"""The elongation of a highlight, against ellipses whose axes are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from matcap.flash.highlight import elongation, find_highlight


def ellipse(ratio: float, angle: float, width: float) -> np.ndarray:
    """(192, 256) a Gaussian spot on grey, `ratio` times as long as wide."""
    u = (np.arange(256) + 0.5)[None] * 2.0 / 256 - 1.0 - 0.1
    v = (192 - 2.0 * (np.arange(192) + 0.5)[:, None]) / 256 + 0.05
    along = u * math.cos(angle) + v * math.sin(angle)
    aside = -u * math.sin(angle) + v * math.cos(angle)
    return 0.1 + 0.8 * np.exp(-0.5 * ((along / (width * ratio)) ** 2 + (aside / width) ** 2))


@pytest.mark.parametrize("width", [0.015, 0.08, 0.15])
@pytest.mark.parametrize(("ratio", "angle"), [(1.0, 0.0), (1.5, 0.4), (1.5, -1.2), (2.0, 1.5)])
def test_length_over_width(ratio: float, angle: float, width: float) -> None:
    light = ellipse(ratio, angle, width)
    highlight = find_highlight(light)
    assert highlight is not None
    # A blur of 0.3 widths makes it a little rounder.
    assert 0.9 * ratio < elongation(light, highlight) < 1.05 * ratio
