"""Relief of one strength everywhere."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from photographed import photographed

from matcap.capture.exemplar.filters import split
from matcap.capture.exemplar.relief_spectrum import BANDS, ReliefSpectrum, equalise, slope_spectrum


@cache
def _bumps() -> np.ndarray:
    shot = photographed(0.2, 0.0, width=768, height=512)
    return (shot.maps.height / shot.maps.texel_size)[0].numpy()


@cache
def _grainy() -> tuple[np.ndarray, np.ndarray]:
    """Bumps with waves of all lengths, and their spectrum by band."""
    height = _bumps() + 0.02 * np.random.default_rng(0).standard_normal((512, 768))
    return height.astype(np.float32), slope_spectrum(height.astype(np.float32))


@cache
def _even(grainy: bool = False) -> np.ndarray:
    return equalise(_grainy()[0] if grainy else _bumps(), None)


def slopes(height):
    """(H, W) slopes along x and along y, which points up."""
    down, across = np.gradient(height)
    return across, -down


def _estimate(slope: np.ndarray, deviation: float = 0.02) -> ReliefSpectrum:
    """Slopes measured in a photograph, with deviations that are a share of their energies."""
    energy = np.square(slope).sum(1)
    return ReliefSpectrum(
        np.zeros_like(slope), slope.copy(), np.ones_like(slope), deviation * energy
    )


def _strength(height: np.ndarray, where: tuple[slice, slice]) -> tuple[float, float]:
    x, y = slopes(height)
    return float(np.sqrt(np.square(x[where]).mean())), float(np.sqrt(np.square(y[where]).mean()))


def test_bands_add_up() -> None:
    height = _bumps()
    assert np.allclose(sum(split(height)), height, atol=1e-4)


@pytest.mark.parametrize("band", range(len(BANDS)))
def test_a_wave_is_in_its_own_band(band: int) -> None:
    longest, shortest = BANDS[band]
    length = (longest * shortest) ** 0.5
    x = np.arange(512, dtype=np.float32)
    wave = np.tile(np.sin(2.0 * np.pi * x / length), (256, 1)).astype(np.float32)
    energies = [float(np.square(b[64:-64, 64:-64]).mean()) for b in split(wave)]
    assert energies[band] > 0.9 * sum(energies)


def test_relief_gets_the_strength_that_is_told_in_every_band() -> None:
    """Also of the finest waves, of which networks draw a tenth."""
    height, true = _grainy()
    shrunk = [
        share * band
        for share, band in zip((0.5, 0.5, 0.5, 0.4, 0.2, 0.1, 1), split(height), strict=True)
    ]
    result = _estimate(true)
    found = slope_spectrum(equalise(sum(shrunk).astype(np.float32), result))
    assert np.allclose(np.sqrt(np.square(found).sum(1)), np.sqrt(np.square(true).sum(1)), rtol=0.1)


def test_what_is_told_of_some_bands_holds_of_those_nothing_is_told_of() -> None:
    height, true = _grainy()
    result = _estimate(true)
    result.slope[:2], result.deviation[:2] = 0.0, 1.0
    found = slope_spectrum(equalise(np.asarray(0.3 * height, np.float32), result))
    ratio = np.sqrt(np.square(found[:2]).sum(1) / np.square(true[:2]).sum(1))
    assert (ratio > 0.6).all() and (ratio < 1.3).all()


def test_even_relief_is_left_as_it_is() -> None:
    before, after = (np.stack(slopes(h)) for h in (_bumps(), _even()))
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


def test_ridges_do_not_run_around_the_flash() -> None:
    """What one flash hardly shows, waves across its light, is drawn fainter; it comes out as strong
    as where the light runs along them.
    """
    height = _bumps()
    y, x = np.mgrid[1 : -1 : height.shape[0] * 1j, -1.5 : 1.5 : height.shape[1] * 1j]
    shows = np.stack([x, y]).astype(np.float32)
    along = x**2 / (x**2 + y**2)  # of waves along x, there; a network shrinks what is across
    spectrum, drawn = np.fft.fft2(height), np.zeros_like(height)
    fx, fy = np.fft.fftfreq(height.shape[1]), np.fft.fftfreq(height.shape[0])[:, None]
    own = np.divide(fx**2, fx**2 + fy**2, out=np.zeros(height.shape), where=(fx != 0) | (fy != 0))
    for share, place in ((own, along), (1.0 - own, 1.0 - along)):
        waves = np.fft.ifft2(spectrum * share).real
        drawn += ((0.25 + 0.75 * place) * waves).astype(np.float32)
    left, top = (slice(192, 320), slice(0, 160)), (slice(0, 128), slice(304, 464))

    def anisotropy(relief: np.ndarray) -> float:
        (a, b), (c, d) = _strength(relief, left), _strength(relief, top)
        return (a * d) / (b * c)

    true = anisotropy(height)
    assert anisotropy(drawn) > 2.0 * true
    assert anisotropy(equalise(drawn, None, shows)) == pytest.approx(true, rel=0.35)


def _waves(fx: float, fy: float, size: int = 256) -> np.ndarray:
    y, x = np.mgrid[0:size, 0:size].astype(np.float32)
    return np.sin(2.0 * np.pi * (fx * x + fy * y)).astype(np.float32)


def test_waves_are_as_strong_as_where_they_are_shown_best() -> None:
    """Light slants up to the right in the right half, and up to the left in the left one."""
    right = np.repeat(np.array([0.0, 1.0], np.float32), 128)[None, :] * np.ones(
        (256, 1), np.float32
    )
    shows = np.stack([np.ones_like(right), 2.0 * right - 1.0])
    rising, falling = _waves(0.06, -0.06), _waves(0.06, 0.06)  # rows count downwards
    even = equalise((0.3 + 0.7 * right) * rising + 0.5 * falling, None, shows)
    middle = (slice(64, 192), slice(32, 224))
    found = [
        float((even * wave)[middle].mean() / np.square(wave)[middle].mean())
        for wave in (rising, falling)
    ]
    assert found[0] / found[1] == pytest.approx(2.0, rel=0.15)


@pytest.mark.parametrize("way", [(0.04, 0.04), (0.04, -0.04)])
def test_waves_of_any_direction_are_left_as_they_are(way) -> None:
    """Eigenvectors of their slopes' covariance turn as the waves do."""
    crossing = (1.1 * way[0], -0.9 * way[1])  # in the same band
    height = _waves(*way) + 0.2 * _waves(*crossing)
    even = equalise(height, None)
    before, after = (np.stack(slopes(h))[:, 32:-32, 32:-32] for h in (height, even))
    assert np.abs(after - before).mean() < 0.1 * np.abs(before).mean()


@pytest.mark.parametrize(
    ("result", "deviation", "least", "most"),
    [(2.0, 0.05, 1.9, 2.1), (0.5, 0.05, 0.47, 0.53), (2.0, 100.0, 0.95, 1.3), (2.0, 0.9, 1.3, 2.1)],
)
def test_relief_becomes_as_strong_as_the_photograph_says_so_far_as_it_is_sure(
    result, deviation, least, most
) -> None:
    height, found = _grainy()
    own = _strength(_even(grainy=True), (slice(None), slice(None)))[0]
    spectrum = _estimate(result * found, deviation)
    now = _strength(equalise(height, spectrum), (slice(None), slice(None)))[0]
    assert least < now / own < most


def test_what_the_photograph_tells_to_be_flat_becomes_flat() -> None:
    height = _bumps()
    drawn = slope_spectrum(height)
    nothing = replace(_estimate(drawn, 0.02), slope=np.zeros_like(drawn))
    found = slope_spectrum(equalise(height, nothing))
    assert np.square(found).sum() < 0.05 * np.square(drawn).sum()


def test_a_bowl_is_no_relief() -> None:
    height = _bumps()
    y, x = np.mgrid[-1 : 1 : height.shape[0] * 1j, -1.5 : 1.5 : height.shape[1] * 1j]
    bowl = (60.0 * (x**2 + y**2)).astype(np.float32)
    left = equalise(height + bowl, None) - _even()
    assert left.std() < 0.05 * bowl.std()
