"""The surface whose slopes are measured, each by its precision."""

import cv2
import numpy as np
import pytest
import torch

from matcap.capture.multiview import surface
from matcap.capture.multiview.surface import integrated, surface_of, texel_slopes, transposed
from matcap.capture.multiview.texels import slopes_of

SIZE = (75, 100)
TEXEL = 2.0 / SIZE[1]


@pytest.fixture(scope="module")
def slopes():
    """(2, H, W) slopes of a rough surface."""
    noise = cv2.GaussianBlur(np.random.default_rng(0).normal(size=SIZE), (0, 0), 1.5)
    return slopes_of(torch.from_numpy(0.5 * TEXEL * noise / noise.std()).float()[None], TEXEL)


def _precision(across, along):
    each = [across, along, 0.0]
    return torch.tensor(each)[:, None, None].expand(3, *SIZE)


def _off(height, slopes):
    left = slopes_of(height, TEXEL) - slopes
    return float(left.square().mean().sqrt() / slopes.square().mean().sqrt())


def test_slopes_of_a_surface_come_back(slopes):
    assert _off(surface_of(slopes, TEXEL, _precision(100.0, 100.0)), slopes) < 0.01


def test_what_is_told_along_one_way_tells_the_other(slopes, monkeypatch):
    """As two photographs do: slopes to a side are measured, those across it are noise."""
    generator = torch.Generator().manual_seed(1)
    noise = torch.tensor([0.01, 1.0])[:, None, None] * slopes.std()
    seen = slopes + noise * torch.randn(slopes.shape, generator=generator)
    known = _precision(*(noise[:, 0, 0] ** -2).tolist())
    monkeypatch.setattr(surface, "_MODEL", 0.0)
    found = surface_of(seen, TEXEL, known)
    assert _off(found, slopes) < 0.3 * _off(integrated(seen, TEXEL), slopes)


def test_what_nobody_knows_of_a_place_moves_nothing(slopes):
    wrong = slopes.clone()
    wrong[:, 30:45, 40:60] = 3.0
    known = _precision(100.0, 100.0).clone()
    known[:, 30:45, 40:60] = 1e-6
    height = surface_of(wrong, TEXEL, known)
    away = torch.ones(SIZE, dtype=torch.bool)
    away[25:50, 35:65] = False
    off = (slopes_of(height, TEXEL) - slopes)[:, away].abs().mean()
    assert off < 0.1 * slopes.abs().mean()
    assert torch.isfinite(height).all()


@pytest.mark.parametrize("size", [(8, 9), (31, 40)])
def test_the_gradient_is_the_slopes_transpose(size):
    rng = np.random.default_rng(2)
    height, slopes = (rng.normal(size=s).astype(np.float32) for s in (size, (2, *size)))
    both = np.vdot(texel_slopes(height), slopes), np.vdot(height, transposed(slopes))
    assert both[0] == pytest.approx(both[1], rel=1e-4)
