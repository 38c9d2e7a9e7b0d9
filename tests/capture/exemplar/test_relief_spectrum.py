"""Relief's and albedo's strength in closed form, against simulated truth."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from photographed import photographed

from matcap.capture.exemplar.filters import filled
from matcap.capture.exemplar.network.inputs import network_inputs
from matcap.capture.exemplar.relief_spectrum import BANDS, measure_relief_spectrum, slope_spectrum


def _measured(slope: float, contrast: float, **kwargs: int):
    shot = photographed(slope, contrast, width=1024, height=768, **kwargs)
    valid = torch.ones(shot.linear.shape[-2:], dtype=torch.bool)
    inputs = network_inputs(shot.linear, valid, shot.uniform, shot.points)
    found = measure_relief_spectrum(
        inputs.log.mean(0).numpy(), inputs.slope_sensitivity.numpy(), valid.numpy()
    )
    assert found is not None
    true = slope_spectrum((shot.maps.height / shot.maps.texel_size)[0].numpy())
    return found, true


@pytest.mark.parametrize("slope", [0.1, 0.3])
def test_slopes_are_found_as_strong_as_they_are(slope: float) -> None:
    found, true = _measured(slope, 0.03)
    whole = np.sqrt(np.square(true).sum())
    assert found.relief == pytest.approx(whole, rel=0.2)
    # And in the band that holds most of them.
    band = int(np.square(true).sum(1).argmax())
    here = np.sqrt(np.square(found.slope[band]).sum() / np.square(true[band]).sum())
    assert 0.8 < here < 1.25
    assert found.significance[band].mean() > 0.8
    values = found.document()
    assert sum(b["slope"] ** 2 for b in values["bands"]) == pytest.approx(values["relief"] ** 2)
    assert [tuple(b["wavelengths"]) for b in values["bands"]] == list(BANDS)


def test_albedo_alone_is_not_taken_for_relief() -> None:
    found, _ = _measured(1e-4, 0.3)
    assert np.sqrt(np.square(found.albedo).sum()) == pytest.approx(0.3, rel=0.35)
    relief = float(np.sqrt((found.significance * np.square(found.slope)).sum()))
    assert relief < 0.3  # 0.3 of log albedo would be slopes of 1 where the light slants by 0.3


def test_one_band_of_energy_stays_in_its_band() -> None:
    x = np.arange(512)
    wave = np.sin(2.0 * np.pi * x / 12.0)[None].repeat(384, 0).astype(np.float32)
    spectrum = np.square(slope_spectrum(wave)).sum(1)
    band = next(i for i, (longest, shortest) in enumerate(BANDS) if shortest < 12.0 <= longest)
    assert spectrum[band] > 0.95 * spectrum.sum()


@pytest.mark.parametrize("least", [0.02, 0.2])
def test_sparkles_that_clip_leave_strengths_as_they_are(least: float) -> None:
    """Every window has lost texels, the brightest ones; a few more is no reason to tell nothing."""
    slopes = _slopes()
    shows = np.zeros((2, *slopes.shape), np.float32)
    shows[0] = np.linspace(-1.1, 1.1, slopes.shape[1])
    log = shows[0] * slopes
    whole = _along_x(measure_relief_spectrum(log, shows, np.ones(slopes.shape, bool)))[0]
    lost = np.random.default_rng(2).random(slopes.shape) < least
    found = measure_relief_spectrum(filled(log, ~lost), shows, ~lost)
    assert found is not None
    assert _along_x(found)[0] == pytest.approx(whole, rel=0.2)


def test_what_another_response_tells_differently_is_doubted() -> None:
    shot = photographed(0.2, 0.1)
    valid = torch.ones(shot.linear.shape[-2:], dtype=torch.bool)
    inputs = network_inputs(shot.linear, valid, shot.uniform, shot.points)
    log, shows = inputs.log.mean(0).numpy(), inputs.slope_sensitivity.numpy()
    alone, alike, apart = (
        measure_relief_spectrum(log, shows, valid.numpy(), other_sensitivity=other).deviation
        for other in (None, shows, 1.5 * shows)
    )
    assert np.allclose(alike, alone)
    strongest = np.argmax(apart - alone)
    assert apart[strongest] > 1.5 * alone[strongest]


def test_streaks_that_are_stronger_at_the_rim_are_no_sure_relief() -> None:
    """Albedo of one direction whose contrast grows by a tenth: what is told is within its doubt.

    Bands that the streaks have no waves in are slopes of 1e-4 and less, and their standard errors
    too: rounding errors of the regression, which differ with the machine. 1e-3 is none.
    """
    streaks = 3.0 * _slopes()
    shows = np.zeros((2, *streaks.shape), np.float32)
    shows[0] = np.linspace(-0.6, 0.6, streaks.shape[1])
    log = streaks * (1.0 + 0.1 * np.square(shows[0] / 0.6))
    found = measure_relief_spectrum(log, shows, np.ones(streaks.shape, bool))
    assert (np.square(found.slope).sum(1) < 2.5 * found.deviation + 1e-3**2).all()


def test_albedo_that_mirrored_light_dilutes_is_no_relief() -> None:
    """Its drawing is fainter around the flash's foot in all directions; slopes' along the light."""
    rows, columns = (np.linspace(-1.0, 1.0, side) for side in (384, 640))
    shows = np.stack(np.broadcast_arrays(columns[None, :], 0.6 * rows[:, None])).astype(np.float32)
    share = (1.0 - 0.5 * np.exp(-np.square(shows).sum(0) / 0.25)).astype(np.float32)
    grain, height = (
        cv2.GaussianBlur(np.random.default_rng(seed).standard_normal(share.shape), (0, 0), 2.0 + k)
        for k, seed in enumerate((1, 11))
    )
    albedo = share * (0.3 * grain / grain.std()).astype(np.float32)
    slopes = np.stack([np.gradient(height, axis=1), -np.gradient(height, axis=0)])
    slopes *= 0.1 / np.sqrt(np.square(slopes).sum(0).mean())
    relief = (shows * slopes).sum(0).astype(np.float32)
    seen = np.ones(share.shape, bool)
    # Gaps are diluted more than the mean of the light is.
    diluted, both = (
        measure_relief_spectrum(log, shows, seen, matte=1.0 - 0.3 * (1.0 - share))
        for log in (albedo, albedo + relief)
    )
    assert diluted.relief < 0.12  # 0.25 where every window has as much albedo
    assert both.relief == pytest.approx(0.1, rel=0.35)


def test_too_little_to_look_at_says_nothing() -> None:
    nothing = np.zeros((256, 256), np.float32)
    shows = np.zeros((2, 256, 256), np.float32)
    assert measure_relief_spectrum(nothing, shows, np.zeros((256, 256), bool)) is None
    assert measure_relief_spectrum(nothing[:64], shows[:, :64], np.ones((64, 256), bool)) is None


def _slopes(seed: int = 3) -> np.ndarray:
    """Slopes along x of isotropic bumps, 0.1 on average."""
    noise = np.random.default_rng(seed).standard_normal((384, 640)).astype(np.float32)
    slopes = np.gradient(cv2.GaussianBlur(noise, (0, 0), 3.0), axis=1)
    return (0.1 * slopes / slopes.std()).astype(np.float32)


def _along_x(found) -> tuple[float, float]:
    """Slope and albedo of waves along x, all bands together."""
    return tuple(float(np.sqrt(np.square(a[:, 0]).sum())) for a in (found.slope, found.albedo))


def test_albedo_that_goes_with_the_slope_is_told_from_it() -> None:
    """Cracks that are dark on one side: E(s) = A + 2 C s + S s^2, and light that slants one way."""
    slopes = _slopes()
    shows = np.zeros((2, *slopes.shape), np.float32)
    shows[0] = np.linspace(0.0, 1.1, slopes.shape[1])
    seen = np.ones(slopes.shape, bool)
    alone = _along_x(measure_relief_spectrum(shows[0] * slopes, shows, seen))[0]
    slope, albedo = _along_x(measure_relief_spectrum((shows[0] + 0.5) * slopes, shows, seen))
    # Energies of the same few windows scatter together: 0.28; without C it would be a half.
    assert slope == pytest.approx(alone, rel=0.3)
    assert albedo == pytest.approx(0.5 * alone, rel=0.4)


def test_the_sensors_noise_is_no_albedo() -> None:
    noise = np.random.default_rng(1).standard_normal((384, 640)).astype(np.float32)
    shows, seen = np.zeros((2, *noise.shape), np.float32), np.ones(noise.shape, bool)
    known = measure_relief_spectrum(0.1 * noise, shows, seen, noise=0.1)
    unknown = measure_relief_spectrum(0.1 * noise, shows, seen)
    assert np.square(known.albedo).sum() < 0.1 * np.square(unknown.albedo).sum()
