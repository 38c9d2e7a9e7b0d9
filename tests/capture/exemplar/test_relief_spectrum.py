"""The relief spectrum, and relief scaled to it."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from arrays import photo_from_array
from photographed import photographed, whole_plane
from typer.testing import CliRunner

from matcap.capture.exemplar.estimate import measured_spectrum, scaled_to_spectrum
from matcap.capture.exemplar.network.network import load_inverse, network_inputs
from matcap.capture.exemplar.octaves import BANDS, filled, split
from matcap.capture.exemplar.predict import predict_maps
from matcap.capture.exemplar.relief_spectrum import (
    DIRECTIONS,
    ReliefSpectrum,
    equalise,
    measure_relief_spectrum,
    slope_energies,
    slope_spectrum,
    undrawn_factors,
)
from matcap.capture.rectified import Observation
from matcap.cli.main import command_line
from matcap.files.color import srgb_encode
from matcap.flash.coarse.fit import fit_coarse
from matcap.flash.light import render_flash
from matcap.flash.rectify import read_plane

# Relief's and albedo's strength in closed form, against simulated truth.


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
def test_slope_energies_are_measured_right(slope: float) -> None:
    found, true = _measured(slope, 0.03)
    assert found.relief == pytest.approx(np.sqrt(np.square(true).sum()), rel=0.2)
    # And in the band that holds most of them.
    band = int(np.square(true).sum(1).argmax())
    here = np.sqrt(np.square(found.slope[band]).sum() / np.square(true[band]).sum())
    assert 0.8 < here < 1.25 and np.square(found.slope[band]).sum() > 2.0 * found.deviation[band]
    values = found.document()
    assert sum(b["slope"] ** 2 for b in values["bands"]) == pytest.approx(values["relief"] ** 2)
    assert [tuple(b["wavelengths"]) for b in values["bands"]] == list(BANDS)


def test_energy_below_the_noise_is_not_known_to_be_zero() -> None:
    _, y = np.indices((384, 512)) / 512.0
    shows = np.stack([np.zeros_like(y), 2.0 * y]).astype(np.float32)
    noise = 0.1 * np.random.default_rng(5).standard_normal(y.shape).astype(np.float32)
    seen = np.ones(y.shape, bool)
    whole, subtracted = (measure_relief_spectrum(noise, shows, seen, n) for n in (0.0, 0.12))
    assert whole is not None and subtracted is not None
    assert (subtracted.deviation > 0.3 * whole.deviation).all()


def test_albedo_alone_is_not_taken_for_relief() -> None:
    found, _ = _measured(1e-4, 0.3)
    assert np.sqrt(np.square(found.albedo).sum()) == pytest.approx(0.3, rel=0.35)
    relief = np.square(found.slope).sum(1)
    significant = np.square(relief) / (np.square(relief) + np.square(found.deviation) + 1e-12)
    # 0.3 of log albedo would be slopes of 1 where the light slants by 0.3.
    assert np.sqrt((significant * relief).sum()) < 0.3


def test_one_band_of_energy_stays_in_its_band() -> None:
    wave = np.sin(2.0 * np.pi * np.arange(512) / 12.0)[None].repeat(384, 0).astype(np.float32)
    spectrum = np.square(slope_spectrum(wave)).sum(1)
    band = next(i for i, (longest, shortest) in enumerate(BANDS) if shortest < 12.0 <= longest)
    assert spectrum[band] > 0.95 * spectrum.sum()


@pytest.mark.parametrize("least", [0.02, 0.2])
def test_clipped_sparkles_leave_the_spectrum_unchanged(least: float) -> None:
    """Every window has lost texels, the brightest ones; a few more is no reason to tell nothing."""
    slopes = _slopes()
    shows = np.zeros((2, *slopes.shape), np.float32)
    shows[0] = np.linspace(-1.1, 1.1, slopes.shape[1])
    log = shows[0] * slopes
    whole = _along_x(measure_relief_spectrum(log, shows, np.ones(slopes.shape, bool)))[0]
    lost = np.random.default_rng(2).random(slopes.shape) < least
    found = measure_relief_spectrum(filled(log, ~lost), shows, ~lost)
    assert found is not None and _along_x(found)[0] == pytest.approx(whole, rel=0.2)


def test_streaks_stronger_at_the_rim_are_within_the_deviation() -> None:
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


def test_albedo_diluted_by_specular_light_is_no_relief() -> None:
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


def test_too_few_windows_give_no_spectrum() -> None:
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


def test_albedo_correlated_with_slope_is_separated() -> None:
    """Cracks that are dark on one side: E(s) = A + 2 C s + S s^2, and light that slants one way."""
    slopes = _slopes()
    shows = np.zeros((2, *slopes.shape), np.float32)
    shows[0] = np.linspace(0.0, 1.1, slopes.shape[1])
    seen = np.ones(slopes.shape, bool)
    alone = _along_x(measure_relief_spectrum(shows[0] * slopes, shows, seen))[0]
    slope, albedo = _along_x(measure_relief_spectrum((shows[0] + 0.5) * slopes, shows, seen))
    # Energies of the same few windows scatter together: 0.28; without C it would be a half.
    assert slope == pytest.approx(alone, rel=0.3) and albedo == pytest.approx(0.5 * alone, rel=0.4)


def test_sensor_noise_is_not_albedo() -> None:
    noise = np.random.default_rng(1).standard_normal((384, 640)).astype(np.float32)
    shows, seen = np.zeros((2, *noise.shape), np.float32), np.ones(noise.shape, bool)
    known = measure_relief_spectrum(0.1 * noise, shows, seen, noise=0.1)
    unknown = measure_relief_spectrum(0.1 * noise, shows, seen)
    assert np.square(known.albedo).sum() < 0.1 * np.square(unknown.albedo).sum()


# How strong relief and albedo are, told of a photograph alone, and by `matcap inspect`.


def _shot(width: int, height: int) -> tuple[np.ndarray, float]:
    """A linear picture (H, W, 3) in [0, 1], and its true relief."""
    shot = photographed(0.2, 0.05, width=width, height=height)
    linear = (shot.linear / shot.linear.quantile(0.999)).permute(1, 2, 0).clamp(0.0, 1.0)
    heights = (shot.maps.height / shot.maps.texel_size)[0].numpy()
    true = float(np.sqrt(np.square(slope_spectrum(heights)).sum()))
    return np.ascontiguousarray(linear.numpy()), true


def _inspected(path: Path, linear: np.ndarray, *options: str) -> str:
    cv2.imwrite(str(path), (srgb_encode(linear)[..., ::-1] * 65535).astype(np.uint16))
    said = CliRunner().invoke(command_line(), ["inspect", str(path), *options])
    assert said.exit_code == 0, said.output
    return said.stdout


def test_relief_is_measured_from_the_photograph_alone() -> None:
    linear, true = _shot(768, 576)
    photo = photo_from_array(linear, long_side=768, fov=65.0, radiometric=True, name="bumps")
    coarse = fit_coarse(photo)
    result = measured_spectrum(Observation.of(read_plane(photo, coarse.setup, 768), coarse))
    assert result is not None and result.relief == pytest.approx(true, rel=0.1)


def test_inspect_reports_the_relief_spectrum(tmp_path: Path) -> None:
    linear, true = _shot(768, 576)
    said = _inspected(tmp_path / "bumps.png", linear, "--json")
    (document,) = json.loads(said)["photographs"]
    # Less than it is: of a PNG neither tone curve nor field of view is known.
    assert 0.5 < document["relief_spectrum"]["relief"] / true < 1.2


def test_a_small_picture_has_no_relief_spectrum(tmp_path: Path) -> None:
    said = _inspected(tmp_path / "bumps.png", _shot(160, 120)[0])
    assert "hot_spot" in said and "relief" not in said


# Relief of one strength everywhere.


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
    energy = np.square(slope).sum(1, keepdims=True)
    error = np.broadcast_to(deviation / np.sqrt(DIRECTIONS) * energy, slope.shape)
    return ReliefSpectrum(np.zeros_like(slope), slope.copy(), error.copy())


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


def test_every_band_is_scaled_to_its_measured_energy() -> None:
    """Also of the finest waves, of which networks draw a tenth."""
    height, true = _grainy()
    shrunk = [
        share * band
        for share, band in zip((0.5, 0.5, 0.5, 0.4, 0.2, 0.1, 1), split(height), strict=True)
    ]
    result = _estimate(true)
    found = slope_spectrum(equalise(sum(shrunk).astype(np.float32), result))
    assert np.allclose(np.sqrt(np.square(found).sum(1)), np.sqrt(np.square(true).sum(1)), rtol=0.1)


def test_brushed_relief_is_not_drawn_as_bumps() -> None:
    """A network that draws bumps where a photograph shows grooves along x: slopes are across."""
    height, _ = _grainy()
    grain = np.random.default_rng(4).standard_normal(height.shape)
    grooves = cv2.GaussianBlur(grain, (0, 0), 12.0, sigmaY=1.5).astype(np.float32)
    across = np.stack(slopes(0.1 / slopes(grooves)[1].std() * grooves))
    rows, columns = (np.linspace(-1.0, 1.0, side) for side in height.shape)
    shows = np.stack(np.broadcast_arrays(columns, 0.7 * rows[:, None])).astype(np.float32)
    seen = np.ones(height.shape, bool)
    measured = measure_relief_spectrum((shows * across).sum(0), shows, seen)
    even, found = equalise(height, None, shows), equalise(height, measured, shows)
    ratios = [float(y.std() / x.std()) for x, y in map(slopes, (even, found))]
    assert ratios[0] == pytest.approx(1.0, abs=0.25) and ratios[1] > 2.0
    # And each band has the energy that it would have without directions.
    energies = [np.square(slope_spectrum(one)).sum(1) for one in (even, found)]
    assert energies[1].sum() == pytest.approx(np.square(measured.slope).sum(), rel=0.5)


def test_unmeasured_bands_follow_the_measured_ones() -> None:
    height, true = _grainy()
    result = _estimate(true)
    result.slope[:2], result.error[:2] = 0.0, 1.0
    found = slope_spectrum(equalise(np.asarray(0.3 * height, np.float32), result))
    ratio = np.sqrt(np.square(found[:2]).sum(1) / np.square(true[:2]).sum(1))
    assert (ratio > 0.6).all() and (ratio < 1.3).all()


def test_even_relief_is_unchanged() -> None:
    before, after = (np.stack(slopes(h)) for h in (_bumps(), _even()))
    correlation = (before * after).sum() / np.sqrt(np.square(before).sum() * np.square(after).sum())
    assert correlation > 0.95


def test_a_bulls_eye_is_equalised() -> None:
    """Relief that fades in the middle, and there shows one slope only, comes out as elsewhere."""
    height = _bumps()
    y, x = np.mgrid[-1 : 1 : height.shape[0] * 1j, -1.5 : 1.5 : height.shape[1] * 1j]
    faint = (height * np.clip(np.hypot(x, y), 0.25, 1.0)).astype(np.float32)
    middle, rim = (slice(200, 312), slice(320, 448)), (slice(0, 112), slice(0, 128))
    even = equalise(faint, None)
    before = _strength(faint, middle)[0] / _strength(faint, rim)[0]
    after = _strength(even, middle)[0] / _strength(even, rim)[0]
    assert before < 0.4 and 0.55 < after < 1.3
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


def test_waves_are_as_strong_as_at_the_best_lit_places() -> None:
    """Light slants up to the right in the right half, and up to the left in the left one."""
    right = np.tile(np.repeat(np.array([0.0, 1.0], np.float32), 128), (256, 1))
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
def test_waves_of_any_direction_are_unchanged(way) -> None:
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
def test_relief_follows_the_measurement_by_its_deviation(result, deviation, least, most) -> None:
    height, found = _grainy()
    own = _strength(_even(grainy=True), (slice(None), slice(None)))[0]
    spectrum = _estimate(result * found, deviation)
    now = _strength(equalise(height, spectrum), (slice(None), slice(None)))[0]
    assert least < now / own < most


def test_relief_measured_as_flat_becomes_flat() -> None:
    height = _bumps()
    drawn = slope_spectrum(height)
    nothing = replace(_estimate(drawn, 0.02), slope=np.zeros_like(drawn))
    found = slope_spectrum(equalise(height, nothing))
    assert np.square(found).sum() < 0.05 * np.square(drawn).sum()


def test_a_bowl_is_no_relief() -> None:
    height = _bumps()
    y, x = np.mgrid[-1 : 1 : height.shape[0] * 1j, -1.5 : 1.5 : height.shape[1] * 1j]
    bowl = (60.0 * (x**2 + y**2)).astype(np.float32)
    assert (equalise(height + bowl, None) - _even()).std() < 0.05 * bowl.std()


# Depth that networks draw where it is dark.


def test_dark_places_of_a_cloth_are_no_pits() -> None:
    """Flat, with yarns of 11 texels and spots of 45: the network draws slopes of both."""
    shot, rng = photographed(1e-4, 0.0, width=640, height=480), np.random.default_rng(0)
    y, x = np.mgrid[0:480, 0:640] / np.float32(1.0)

    def clouds(deviation: float) -> np.ndarray:
        noise = cv2.GaussianBlur(rng.standard_normal(y.shape), (0, 0), deviation)
        return (noise / noise.std()).astype(np.float32)

    yarns = np.sin((x + 2.0 * clouds(6.0)) * 0.57) * np.sin((y + 2.0 * clouds(6.0)) * 0.7)
    tone = torch.from_numpy((0.9 * yarns + 0.2 * clouds(9.0) + 0.1 * clouds(1.0)).astype("f"))
    cloth = replace(shot.maps, diffuse=0.4 * shot.maps.diffuse * tone.exp())
    linear = render_flash(cloth, shot.uniform.setup, shot.points)
    coarse = replace(shot.uniform, diffuse=tuple(cloth.diffuse.mean((1, 2)).tolist()))
    with torch.no_grad():
        observed, predicted = predict_maps(
            Observation.of(whole_plane(linear), coarse), load_inverse()
        )
        even = scaled_to_spectrum(observed, predicted, measured_spectrum(observed))
    before, after = (
        np.sqrt(slope_energies(each.residuals.height[0].numpy())) for each in (predicted, even)
    )
    assert before[0] > 0.2 * before[3] and after[0] < 0.1 * after[3]
    assert before[1] > 0.1 * before[3] and after[1] < 0.1 * after[3]


@pytest.mark.parametrize(
    ("measured", "own", "least", "most"),
    [(0.0, 0.0, 0.0, 0.2), (0.0, 2.0, 0.9, 1.0), (3.0, 0.0, 0.9, 1.0)],
)
def test_long_waves_keep_what_is_measured_or_their_own(measured, own, least, most) -> None:
    """Depth in proportion to wavelength, in place of a depth in proportion to log albedo."""
    tone = np.stack(split(np.random.default_rng(1).standard_normal((256, 256)).astype("f")))[:-1]
    more = np.stack(split(np.random.default_rng(2).standard_normal((256, 256)).astype("f")))[:-1]
    height = np.sqrt(np.prod(BANDS, axis=1))[:, None, None] * (tone + own * more)
    slope = np.zeros((len(BANDS), DIRECTIONS))
    slope[3] = np.sqrt(measured / np.sqrt(DIRECTIONS))
    spectrum = ReliefSpectrum(slope, slope, np.full_like(slope, 1.0))
    wanted = np.square(tone).mean((1, 2))
    wanted[4:] = 0.0
    factors = undrawn_factors(wanted, height, tone, spectrum)
    assert (factors[3:] == 1.0).all() and least <= np.sqrt(factors[0]) <= most
    assert undrawn_factors(wanted, -height, tone, spectrum) == pytest.approx(1.0, abs=1e-3)
