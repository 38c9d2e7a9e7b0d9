"""Evenness of albedo's contrast."""

from __future__ import annotations

import numpy as np
import pytest
from photographed import photographed

from matcap.capture.piece.adapt import even_contrast


@pytest.fixture(scope="module")
def albedo() -> np.ndarray:
    shot = photographed(0.1, 0.3, width=768, height=512)
    return shot.maps.diffuse.log().numpy().astype(np.float32)


def _deviation(albedo: np.ndarray, columns: slice) -> float:
    return float(albedo.mean(0)[:, columns].std())


def test_what_fades_under_the_highlight_is_as_strong_as_beside_it(albedo) -> None:
    columns = np.arange(albedo.shape[2])
    faded = 1.0 - 0.6 * (columns < 300)
    mean = albedo.mean((1, 2), keepdims=True)
    found = even_contrast(
        (mean + faded * (albedo - mean)).astype(np.float32),
        np.broadcast_to((columns >= 300).astype(np.float32), albedo.shape[1:]),
    )
    assert _deviation(found, slice(0, 150)) == pytest.approx(
        _deviation(albedo, slice(0, 150)), rel=0.15
    )
    assert found.mean() == pytest.approx(albedo.mean(), abs=0.02)


def test_what_is_even_stays(albedo) -> None:
    found = even_contrast(albedo, np.ones(albedo.shape[1:], np.float32))
    assert np.abs(found - albedo).mean() < 0.15 * albedo.mean(0).std()


def test_nothing_stays_nothing() -> None:
    flat = np.full((3, 96, 128), -1.0, np.float32)
    assert np.allclose(even_contrast(flat, np.zeros((96, 128), np.float32)), flat, atol=1e-5)
