"""Relief of one strength everywhere."""

from __future__ import annotations

import numpy as np
from photographed import photographed

from matcap.capture.exemplar.equalise import equalise, slopes
from matcap.capture.exemplar.smooth import split


def _bumps() -> np.ndarray:
    shot = photographed(0.2, 0.0, width=768, height=512)
    return (shot.maps.height / shot.maps.texel_size)[0].numpy()


def _strength(height: np.ndarray, where: tuple[slice, slice]) -> tuple[float, float]:
    x, y = slopes(height)
    return float(np.sqrt(np.square(x[where]).mean())), float(np.sqrt(np.square(y[where]).mean()))


def test_bands_add_up() -> None:
    height = _bumps()
    assert np.allclose(sum(split(height)), height, atol=1e-4)


def test_even_relief_is_left_as_it_is() -> None:
    height = _bumps()
    even = equalise(height, None)
    before, after = (np.stack(slopes(h)) for h in (height, even))
    correlation = (before * after).sum() / np.sqrt(np.square(before).sum() * np.square(after).sum())
    assert correlation > 0.95


def test_a_bulls_eye_is_evened_out() -> None:
    """Relief that fades in the middle, and there shows one slope only, comes out as elsewhere."""
    height = _bumps()
    y, x = np.mgrid[-1 : 1 : height.shape[0] * 1j, -1.5 : 1.5 : height.shape[1] * 1j]
    fading = np.clip(np.hypot(x, y), 0.25, 1.0)
    faint = (height * fading).astype(np.float32)
    middle, rim = (slice(200, 312), slice(320, 448)), (slice(0, 112), slice(0, 128))
    even = equalise(faint, None)
    before = _strength(faint, middle)[0] / _strength(faint, rim)[0]
    after = _strength(even, middle)[0] / _strength(even, rim)[0]
    assert before < 0.4
    assert 0.55 < after < 1.3
    assert 0.55 < _strength(even, middle)[1] / _strength(even, rim)[1] < 1.3
