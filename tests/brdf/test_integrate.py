"""Heights from slopes."""

from __future__ import annotations

import numpy as np
import pytest

from matcap.brdf.integrate import integrate


@pytest.mark.parametrize(("height", "width"), [(64, 96), (63, 97)])
def test_steps_of_a_height_give_it_back_to_the_finest_wave(height: int, width: int) -> None:
    noise = np.random.default_rng(0).standard_normal((height, width)).astype(np.float32)
    found = integrate(np.diff(noise, axis=1), np.diff(noise, axis=0))
    expected = noise - noise.mean()
    inner = (slice(4, -4), slice(4, -4)) if height % 2 else (slice(None), slice(None))
    assert np.abs((found - expected)[inner]).max() < (0.2 if height % 2 else 1e-3)


def test_what_no_height_has_is_left_out() -> None:
    """A slope field that turns in circles belongs to no surface."""
    y, x = np.meshgrid(np.linspace(-4, 4, 64), np.linspace(-4, 4, 64), indexing="ij")
    swirl = np.exp(-(np.square(x) + np.square(y))).astype(np.float32)

    def between(across: np.ndarray, down: np.ndarray) -> np.ndarray:
        columns, rows = across[:, 1:] + across[:, :-1], down[1:] + down[:-1]
        return integrate(columns.astype(np.float32), rows.astype(np.float32))

    turned = between(-y * swirl, x * swirl)
    downhill = between(-x * swirl, -y * swirl)
    assert np.abs(turned).max() < 0.05 * np.abs(downhill).max()
