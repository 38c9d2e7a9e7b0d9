"""Heights of slopes, against surfaces whose slopes are known in closed form."""

import numpy as np
import pytest

from matcap.brdf.integrate import integrate_periodic


def waves(rows, columns, texel):
    """(H, W) height and its (2, H, W) slopes, y upwards, of a few waves that repeat."""
    y, x = np.mgrid[:rows, :columns].astype(np.float64)
    height, slopes = np.zeros((rows, columns)), np.zeros((2, rows, columns))
    for size, across, down, phase in ((1.0, 2, 0, 0.1), (0.5, 3, -2, 1.0), (0.3, 0, 5, 2.0)):
        wx, wy = 2.0 * np.pi * across / columns, 2.0 * np.pi * down / rows
        angle = wx * x + wy * y + phase
        height += size * np.sin(angle)
        slopes += size * np.cos(angle) * np.array([wx, -wy])[:, None, None] / texel
    return height, slopes


@pytest.mark.parametrize(("rows", "columns", "texel"), [(32, 48, 1.0), (33, 25, 0.01)])
def test_a_surface_comes_back_from_its_slopes(rows, columns, texel):
    height, slopes = waves(rows, columns, texel)
    found = integrate_periodic(slopes, texel)
    np.testing.assert_allclose(found[0], height, atol=1e-5)
    assert found.dtype == np.float32


def test_means_and_curl_that_no_repeating_surface_has_are_left_out():
    height, slopes = waves(32, 32, 1.0)
    tilted = slopes + np.array([0.3, -0.2])[:, None, None]
    rolling = np.stack([slopes[1], -slopes[0]])  # the slopes' field turned: all curl
    np.testing.assert_allclose(integrate_periodic(tilted)[0], height, atol=1e-5)
    np.testing.assert_allclose(integrate_periodic(rolling), 0.0, atol=1e-5)
