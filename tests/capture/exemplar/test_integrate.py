"""Heights from slopes."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from matcap.capture.exemplar.integrate import integrate


@pytest.mark.parametrize(("height", "width"), [(64, 96), (63, 97)])
def test_slopes_of_a_height_give_it_back(height: int, width: int) -> None:
    y, x = torch.meshgrid(
        torch.arange(height, dtype=torch.float32),
        torch.arange(width, dtype=torch.float32),
        indexing="ij",
    )
    bumps = torch.sin(x / 5.0) * torch.cos(y / 7.0) + 0.02 * x - 0.01 * y
    down, across = torch.gradient(bumps)
    found = torch.from_numpy(integrate(across.numpy(), -down.numpy()))
    expected = bumps - bumps.mean()
    inner = (slice(4, -4), slice(4, -4))
    assert float((found - expected)[inner].abs().max()) < 0.05


def test_what_no_height_has_is_left_out() -> None:
    """A slope field that turns in circles belongs to no surface."""
    y, x = torch.meshgrid(torch.linspace(-4, 4, 64), torch.linspace(-4, 4, 64), indexing="ij")
    swirl = torch.exp(-(x.square() + y.square()))
    turned = integrate((-y * swirl).numpy(), (-x * swirl).numpy())
    downhill = integrate((-x * swirl).numpy(), (y * swirl).numpy())
    assert np.abs(turned).max() < 0.05 * np.abs(downhill).max()
