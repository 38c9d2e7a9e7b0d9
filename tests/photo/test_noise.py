"""The sensor's noise: found where it is known, drawn again as it was drawn first."""

import cv2
import numpy as np
import pytest
from simulated.files import BLACK, WHITE, gain_map, mosaic, opcode_list, write_dng

from matcap.photo.load import load_photo
from matcap.photo.sensor_noise import SensorNoise, find_noise

LEVELS = np.full((2, 2), float(BLACK))
RANGE = WHITE - BLACK
SENSORS = [(2000.0, 3.0), (500.0, 12.0), (8000.0, 2.0)]  # electrons: full well, read noise


def numbers_of(well, read):
    """The same sensor's noise, in the file's numbers."""
    return SensorNoise(RANGE / well, (read * RANGE / well) ** 2)


def falloff(height=768, width=1024):
    """(H, W, 3) grey light as a flash leaves it: 0.6 in the middle, a tenth of it in a corner."""
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    return np.repeat((0.6 / (1 + 1.6 * (x**2 + y**2)) ** 2)[..., None], 3, axis=2)


def noisy(light, sensor, seed=1):
    return sensor.added(mosaic(light), LEVELS, seed)


@pytest.mark.parametrize("sensor", SENSORS)
def test_a_plain_surface_tells_the_noise(sensor):
    true = numbers_of(*sensor)
    found = find_noise(noisy(falloff(), true), LEVELS, WHITE)
    signal = np.array([0.06, 0.2, 0.5]) * RANGE
    variance = found.shot * signal + found.read
    np.testing.assert_allclose(variance, true.shot * signal + true.read, rtol=0.12)


@pytest.mark.parametrize("sensor", SENSORS)
def test_texture_is_not_taken_for_noise(sensor):
    """Strong grain everywhere, as sharp as a lens draws it, hardly raises what is found."""
    grain = np.random.default_rng(3).standard_normal((768, 1024)).astype(np.float32)
    grain = cv2.GaussianBlur(grain, (0, 0), 1.2)
    light = falloff() * np.exp(0.3 * grain / grain.std())[..., None]
    true = numbers_of(*sensor)
    found = find_noise(noisy(np.minimum(light, 0.9), true), LEVELS, WHITE)
    signal = np.array([0.06, 0.2, 0.5]) * RANGE
    share = (found.shot * signal + found.read) / (true.shot * signal + true.read)
    assert (share > 0.85).all() and (share < 1.6).all()


def test_without_noise_next_to_none_is_found():
    found = find_noise(mosaic(falloff()), LEVELS, WHITE)
    signal = 0.2 * RANGE
    assert found.shot * signal + found.read < 1.0  # rounding alone varies by 1/12


def test_what_is_added_has_the_variance_it_states():
    sensor = SensorNoise(2.0, 30.0)
    for level in (0.0, 0.05, 0.5):
        flat = mosaic(np.full((512, 512, 3), level), black=600)
        added = sensor.added(flat, np.full((2, 2), 600.0), 0).astype(float) - flat
        assert added.mean() == pytest.approx(0.0, abs=0.5)
        expected = 2.0 * (flat[0, 0] - 600.0) + 30.0 + 1 / 12
        assert added.var() == pytest.approx(expected, rel=0.02)


def test_black_levels_may_differ_by_place():
    black = np.array([[64.0, 80.0], [96.0, 64.0]])
    tiled = np.tile(black, (256, 256))
    true = SensorNoise(2.0, 40.0)
    clean = np.rint(mosaic(falloff(512, 512)) - BLACK + tiled).astype(np.uint16)
    found = find_noise(true.added(clean, black, 2), black, WHITE)
    assert found.shot == pytest.approx(2.0, rel=0.12)


@pytest.mark.parametrize("size", [(16, 16), (63, 65), (2, 2)])
def test_too_little_to_tell_is_none(size):
    assert find_noise(np.full(size, 900, np.uint16), LEVELS, WHITE) is None


def test_an_overexposed_picture_is_none():
    assert find_noise(np.full((512, 512), WHITE, np.uint16), LEVELS, WHITE) is None


@pytest.mark.parametrize("long_side", [None, 800, 512, 300])
def test_the_draw_looks_like_the_noise_in_the_picture(tmp_path, long_side):
    """Through demosaicing, white balance and shrinking, whole and two by two."""
    true = numbers_of(2000.0, 3.0)
    neutral = (0.5, 1.0, 0.6)
    light = falloff() * neutral
    clean = write_dng(tmp_path / "clean.dng", mosaic(light), neutral=neutral)
    dirty = write_dng(tmp_path / "dirty.dng", noisy(light, true), neutral=neutral)
    photo = load_photo(dirty, long_side=long_side)
    real = photo.pixels - load_photo(clean, long_side=long_side, noise=False).pixels
    assert photo.noise.shape == photo.pixels.shape
    assert photo.noise.dtype == np.float32 and photo.noise.flags.c_contiguous
    np.testing.assert_allclose(photo.noise.std((0, 1)), real.std((0, 1)), rtol=0.15)
    assert abs(np.corrcoef(photo.noise.ravel(), real.ravel())[0, 1]) < 0.2  # another draw

    def beside(picture):
        return (picture[:, 1:] * picture[:, :-1]).mean() / np.square(picture).mean()

    assert beside(photo.noise) == pytest.approx(beside(real), abs=0.1)


def test_lens_shading_lifts_the_noise_too(tmp_path):
    light = np.full((384, 512, 3), 0.2)
    gains = np.ones((2, 2, 1)) * np.array([1.0, 3.0])[None, :, None]
    opcodes = opcode_list(gain_map(gains, (384, 512)))
    path = write_dng(tmp_path / "a.dng", noisy(light, numbers_of(2000.0, 3.0)), opcodes2=opcodes)
    noise = load_photo(path).noise
    assert noise[:, -40:].std() > 2.0 * noise[:, :40].std()


def test_a_portrait_s_noise_lies_as_it_does(tmp_path):
    dark_left = np.full((512, 384, 3), 0.3)
    dark_left[:256] = 0.03
    path = write_dng(tmp_path / "a.dng", noisy(dark_left, numbers_of(500.0, 3.0)))
    photo = load_photo(path)
    assert photo.turned and photo.noise.shape == photo.pixels.shape
    dark = photo.pixels.mean(axis=2) < 0.1
    assert photo.noise[dark].std() < 0.7 * photo.noise[~dark].std()


def test_there_is_none_where_it_is_not_asked_for_or_has_averaged_out(tmp_path, codes):
    path = write_dng(tmp_path / "a.dng", noisy(falloff(), numbers_of(2000.0, 3.0)))
    assert load_photo(path, noise=False).noise is None
    assert load_photo(path, long_side=1024 // 6).noise is None
    jpeg = tmp_path / "a.jpg"
    cv2.imwrite(str(jpeg), codes)
    assert load_photo(jpeg).noise is None


def test_the_same_file_gives_the_same_draw(tmp_path):
    path = write_dng(tmp_path / "a.dng", noisy(falloff(), numbers_of(2000.0, 3.0)))
    first, second = load_photo(path), load_photo(path)
    np.testing.assert_array_equal(first.noise, second.noise)
    np.testing.assert_array_equal(first.pixels, load_photo(path, noise=False).pixels)
