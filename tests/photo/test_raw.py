"""RAW files: noise, JPEG XL, lens shading."""

import struct
import subprocess
import sys

import cv2
import numpy as np
import pytest
from simulated.files import (
    BLACK,
    WHITE,
    beside_preview,
    color_matrix,
    gain_map,
    mosaic,
    opcode_list,
    write_dng,
)

from matcap.errors import MatcapError
from matcap.photo.load import load_photo
from matcap.photo.raw import SensorNoise, find_noise
from matcap.photo.raw_samples import Shading, parse_opcodes, plain_dng

# RAW: linear, balanced, oriented once, clipping read off the mosaic, by quiet decoders.

NEUTRAL = (0.5, 1.0, 0.6)
MIXING = np.array([[0.7, 0.25, 0.05], [0.2, 0.7, 0.1], [0.05, 0.25, 0.7]])


def test_decoded_values_are_proportional_to_light(tmp_path):
    levels = np.linspace(0.02, 0.9, 12)
    light = np.repeat(levels, 16)[None, :, None] * np.ones((96, 1, 3))
    photo = load_photo(write_dng(tmp_path / "ramp.dng", mosaic(light)))
    measured = photo.pixels[:, 8::16].mean(axis=0)
    for channel in range(3):
        slope, offset = np.polyfit(levels, measured[:, channel], 1)
        assert slope == pytest.approx(1.0, abs=1e-3) and offset == pytest.approx(0.0, abs=3e-4)
    assert photo.radiometric


@pytest.mark.parametrize("planes", [1, 3])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_applied_once(tmp_path, light, planes, orientation):
    samples = mosaic(light) if planes == 1 else np.rint(BLACK + light * (WHITE - BLACK))
    plain = load_photo(write_dng(tmp_path / "plain.dng", samples.astype(np.uint16)))
    path = write_dng(tmp_path / "o.dng", samples.astype(np.uint16), orientation=orientation)
    photo = load_photo(path)
    # What the EXIF standard says of the stored first row and column, in numpy's words.
    upright = {
        1: lambda p: p,
        2: np.fliplr,
        3: lambda p: np.rot90(p, 2),
        4: np.flipud,
        5: lambda p: p.swapaxes(0, 1),
        6: lambda p: np.rot90(p, -1),
        7: lambda p: np.rot90(p, 2).swapaxes(0, 1),
        8: lambda p: np.rot90(p, 1),
    }[orientation](plain.pixels)
    sideways = orientation >= 5
    expected = np.rot90(upright) if sideways else upright
    np.testing.assert_array_equal(photo.pixels, expected)
    assert photo.turned == sideways
    assert photo.original_size == ((96, 128) if sideways else (128, 96))


def test_camera_colours_become_rec709(tmp_path):
    rec709 = np.zeros((96, 128, 3))
    rec709[:, :64], rec709[:, 64:] = (0.5, 0.2, 0.1), (0.1, 0.3, 0.6)
    samples = mosaic(rec709 @ MIXING.T * NEUTRAL)
    options = {"neutral": NEUTRAL, "color_matrix": color_matrix(MIXING)}
    photo = load_photo(write_dng(tmp_path / "a.dng", samples, **options))
    inner = np.r_[4:60, 68:124]
    np.testing.assert_allclose(photo.pixels[4:-4, inner], rec709[4:-4, inner], atol=1.5e-3)


def test_values_above_one_after_the_colour_matrix_are_kept(tmp_path):
    """No photosite is at its limit; Rec.709 red is over 1, and nothing cuts it off."""
    rec709 = np.full((96, 128, 3), 0.3)
    rec709[:, :64, 0] = 1.15
    samples = mosaic(rec709 @ MIXING.T)
    assert samples.max() < 0.98 * WHITE
    photo = load_photo(write_dng(tmp_path / "a.dng", samples, color_matrix=color_matrix(MIXING)))
    np.testing.assert_allclose(photo.pixels[4:-4, 4:60], rec709[4:-4, 4:60], atol=2e-3)
    assert not photo.clipped.any()


@pytest.mark.parametrize("times", [2, 4])
def test_a_smaller_picture_agrees_with_the_whole(tmp_path, light, times):
    fine = cv2.resize(light, (64 * times, 48 * times), interpolation=cv2.INTER_LINEAR)
    path = write_dng(tmp_path / "a.dng", mosaic(fine * NEUTRAL), neutral=NEUTRAL)
    whole, small = load_photo(path).pixels, load_photo(path, long_side=64)
    assert small.original_size == (64 * times, 48 * times)
    np.testing.assert_allclose(small.pixels[1:-1, 1:-1], means(whole)[1:-1, 1:-1], atol=2e-3)


@pytest.mark.parametrize("times", [2, 4])
def test_a_grey_grain_stays_grey_in_a_smaller_picture(tmp_path, times):
    """Red and blue photosites lie on opposite sides of green: its slopes would be colours."""
    grain = np.random.default_rng(5).normal(size=(48 * times, 64 * times))
    log = cv2.GaussianBlur(grain, (0, 0), 3.0)
    grey = 0.2 * np.exp(0.3 * log / log.std())[..., None] * np.ones(3)
    small = load_photo(write_dng(tmp_path / "a.dng", mosaic(grey)), long_side=64).pixels
    colour = np.log(small[1:-1, 1:-1, 0] / small[1:-1, 1:-1, 2])
    assert colour.std() < 0.015  # 0.09 where each colour is left at its place
    np.testing.assert_allclose(small[1:-1, 1:-1], means(grey)[1:-1, 1:-1], rtol=0.08)


def means(picture):
    """Means (48, 64, C) of a picture over squares of pixels."""
    times = picture.shape[1] // 64
    return picture.reshape(48, times, 64, times, -1).mean((1, 3))


def test_a_pixel_is_clipped_where_its_photosites_were(tmp_path):
    light = np.full((96, 128, 3), 0.3)
    # Green alone saturates, and not every photosite does so at the white level exactly.
    light[40:60, 50:80, 1] = 0.995
    photo = load_photo(write_dng(tmp_path / "a.dng", mosaic(light)))
    assert photo.clipped[41:59, 51:79].all()
    assert not photo.clipped[:38].any() and not photo.clipped[62:].any()
    assert not photo.clipped[:, :48].any() and not photo.clipped[:, 82:].any()


def test_channels_clip_at_the_level_that_white_balance_gives_them(tmp_path):
    """Red is lifted twice: at half the white level it is cut off; at 0.4 it is not."""
    light = np.full((96, 128, 3), 0.2)
    light[:, :64, 0] = 0.498
    light[:, 64:, 0] = 0.4
    photo = load_photo(write_dng(tmp_path / "a.dng", mosaic(light), neutral=(0.5, 1.0, 1.0)))
    assert photo.clipped[:, :62].all() and not photo.clipped[:, 66:].any()
    assert photo.pixels.max() <= 1.0


@pytest.mark.parametrize("times", [2, 4])
def test_clip_mask_of_a_smaller_picture(tmp_path, times):
    light = np.full((48 * times, 64 * times, 3), 0.3)
    light[40:60, 50:80] = 1.0
    photo = load_photo(write_dng(tmp_path / "a.dng", mosaic(light)), long_side=64)
    touched = np.zeros_like(light[..., :1])
    touched[39:61, 49:81] = 1.0  # neighbours count, too
    np.testing.assert_array_equal(photo.clipped, means(touched)[..., 0] > 0)


def test_linear_dng_white_is_one(tmp_path):
    light = np.full((96, 128, 3), 0.25)
    light[:, 64:] = 1.0
    samples = np.rint(BLACK + light * (WHITE - BLACK)).astype(np.uint16)
    photo = load_photo(write_dng(tmp_path / "a.dng", samples))
    np.testing.assert_allclose(photo.pixels[:, :64], 0.25, atol=1e-3)
    np.testing.assert_allclose(photo.pixels[:, 64:], 1.0, atol=1e-3)
    np.testing.assert_array_equal(photo.clipped, np.indices((96, 128))[1] >= 64)


def test_exif_of_a_dng(tmp_path, light):
    path = write_dng(tmp_path / "a.dng", mosaic(light), exif={0xA405: 26, 0x9209: 1})
    photo = load_photo(path)
    assert photo.fov == pytest.approx(2 * np.degrees(np.arctan(0.8 * np.hypot(18, 12) / 26)))
    assert (photo.fov_source, photo.flash_fired) == ("exif", True)


@pytest.mark.parametrize("size", [(16, 400), (400, 16), (40, 40)])
def test_a_small_dng_is_called_too_small_not_damaged(tmp_path, size):
    path = write_dng(tmp_path / "a.dng", mosaic(np.full((*size, 3), 0.5)))
    with pytest.raises(MatcapError, match=f"{size[1]} x {size[0]} pixels, too small.* at least 64"):
        load_photo(path)


def test_odd_sizes_are_decoded(tmp_path):
    path = write_dng(tmp_path / "a.dng", mosaic(np.full((97, 131, 3), 0.3)))
    for long_side, shape in [(None, (97, 131)), (65, (48, 65)), (100, (74, 100))]:
        photo = load_photo(path, long_side=long_side)
        assert photo.pixels.shape == (*shape, 3)
        np.testing.assert_allclose(photo.pixels, 0.3, atol=1e-3)


SCRIPT = """
import logging, os, sys, threading
from matcap.files.process import quiet_decoders

inside, done = threading.Event(), threading.Event()
def other():
    with quiet_decoders():
        inside.set(); done.wait()

thread = threading.Thread(target=other)
with quiet_decoders():
    thread.start(); inside.wait()
    os.write(2, b"from C\\n")
    logging.getLogger("tifffile").warning("from a decoder's log")
    print("progress", file=sys.stderr)
os.write(2, b"from C, with another thread still inside\\n")
done.set(); thread.join()
os.write(2, b"after\\n")
print("and again", file=sys.stderr)
"""


WITHOUT_STDERR = """
import os; os.close(2)
from matcap.files.process import quiet_decoders
with quiet_decoders(): print('read')
"""


def test_only_the_output_of_decoders_is_silenced_and_stderr_may_be_closed():
    said = [
        subprocess.run([sys.executable, "-c", one], capture_output=True, text=True, check=True)
        for one in (SCRIPT, WITHOUT_STDERR)
    ]
    assert said[0].stderr == "progress\nafter\nand again\n" and said[1].stdout == "read\n"


# The sensor's noise: found where it is known, drawn again as it was drawn first.

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
def test_noise_is_estimated_from_a_plain_surface(sensor):
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


def test_a_noiseless_raw_has_next_to_no_noise():
    found = find_noise(mosaic(falloff()), LEVELS, WHITE)
    assert found.shot * 0.2 * RANGE + found.read < 1.0  # rounding alone varies by 1/12


def test_added_noise_has_the_variance_of_the_model():
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


@pytest.mark.parametrize(
    ("size", "level"), [((16, 16), 900), ((63, 65), 900), ((2, 2), 900), ((512, 512), WHITE)]
)
def test_too_few_or_overexposed_pixels_give_no_noise_estimate(size, level):
    assert find_noise(np.full(size, level, np.uint16), LEVELS, WHITE) is None


@pytest.mark.parametrize("long_side", [800, 300])
def test_drawn_noise_has_the_spectrum_of_the_real_noise(tmp_path, long_side):
    """Through demosaicing, white balance and shrinking, whole and two by two."""
    true = numbers_of(2000.0, 3.0)
    light = falloff() * NEUTRAL
    clean = write_dng(tmp_path / "clean.dng", mosaic(light), neutral=NEUTRAL)
    dirty = write_dng(tmp_path / "dirty.dng", noisy(light, true), neutral=NEUTRAL)
    photo = load_photo(dirty, long_side=long_side)
    real = photo.pixels - load_photo(clean, long_side=long_side, noise=False).pixels
    assert photo.noise.shape == photo.pixels.shape
    assert photo.noise.dtype == np.float32 and photo.noise.flags.c_contiguous
    np.testing.assert_allclose(photo.noise.std((0, 1)), real.std((0, 1)), rtol=0.15)
    assert abs(np.corrcoef(photo.noise.ravel(), real.ravel())[0, 1]) < 0.2  # another draw

    def beside(picture):
        return (picture[:, 1:] * picture[:, :-1]).mean() / np.square(picture).mean()

    assert beside(photo.noise) == pytest.approx(beside(real), abs=0.1)


def test_lens_shading_scales_the_noise(tmp_path):
    light = np.full((384, 512, 3), 0.2)
    gains = np.ones((2, 2, 1)) * np.array([1.0, 3.0])[None, :, None]
    opcodes = opcode_list(gain_map(gains, (384, 512)))
    path = write_dng(tmp_path / "a.dng", noisy(light, numbers_of(2000.0, 3.0)), opcodes2=opcodes)
    noise = load_photo(path).noise
    assert noise[:, -40:].std() > 2.0 * noise[:, :40].std()


def test_noise_of_a_portrait_is_rotated_with_it(tmp_path):
    dark_above = np.full((512, 384, 3), 0.3)
    dark_above[:256] = 0.03
    photo = load_photo(write_dng(tmp_path / "a.dng", noisy(dark_above, numbers_of(500.0, 3.0))))
    assert photo.turned and photo.noise.shape == photo.pixels.shape
    dark = photo.pixels.mean(axis=2) < 0.1
    assert photo.noise[dark].std() < 0.7 * photo.noise[~dark].std()


def test_noise_is_not_drawn_unless_wanted_or_where_averaged_out(tmp_path, codes):
    path = write_dng(tmp_path / "a.dng", noisy(falloff(), numbers_of(2000.0, 3.0)))
    assert load_photo(path, noise=False).noise is None
    assert load_photo(path, long_side=1024 // 6).noise is None
    few = write_dng(tmp_path / "few.dng", noisy(falloff(64, 64), numbers_of(2000.0, 3.0)))
    assert load_photo(few).noise is None  # too few blocks to tell the sensor's by
    jpeg = tmp_path / "a.jpg"
    cv2.imwrite(str(jpeg), codes)
    assert load_photo(jpeg).noise is None


def test_the_same_file_gives_the_same_draw(tmp_path):
    path = write_dng(tmp_path / "a.dng", noisy(falloff(384, 512), numbers_of(2000.0, 3.0)))
    first, second = load_photo(path), load_photo(path)
    np.testing.assert_array_equal(first.noise, second.noise)
    np.testing.assert_array_equal(first.pixels, load_photo(path, noise=False).pixels)


# DNGs that LibRaw cannot open come out as the same DNGs uncompressed, to the bit.

JPEG_XL = 52546
TILED = {"compression": "zlib", "tile": (32, 48), "predictor": True}


def same(found, expected):
    for name in ("pixels", "clipped", "noise"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert (found.radiometric, found.gain_map_applied) == (True, expected.gain_map_applied)


def stored(light, planes: int):
    """What a sensor's file holds, clipped somewhere."""
    bright = np.clip(2.0 * light * NEUTRAL, 0.0, 1.0)
    linear = np.rint(BLACK + bright * (WHITE - BLACK)).astype(np.uint16)
    return mosaic(bright) if planes == 1 else linear


@pytest.mark.parametrize("byteorder", ["<", ">"])
@pytest.mark.parametrize("planes", [1, 3])
def test_the_uncompressed_copy_has_the_same_samples(tmp_path, light, planes, byteorder):
    options = {
        "neutral": NEUTRAL,
        "color_matrix": color_matrix(np.array([[0.7, 0.25, 0.05], [0.2, 0.7, 0.1], [0, 0.3, 0.7]])),
        "orientation": 3,
        "opcodes2": opcode_list(gain_map(np.full((2, 2, 1), 1.5), (96, 128), planes=planes)),
        "active_area": (3, 2, 91, 120),
        "byteorder": byteorder,
    }
    samples = stored(light, planes)
    packed = write_dng(tmp_path / "packed.dng", samples, **options, **TILED)
    expected = load_photo(write_dng(tmp_path / "plain.dng", samples, **options))
    packed.write_bytes(plain_dng(packed, None))
    same(load_photo(packed), expected)
    assert expected.gain_map_applied and expected.clipped.any()


def test_the_raw_picture_may_lie_beside_a_preview(tmp_path, light):
    samples = stored(light, 1)

    whole = write_dng(tmp_path / "tags.dng", samples)
    packed = beside_preview(whole, tmp_path / "packed.dng", samples, 1, **TILED)
    packed.write_bytes(plain_dng(packed, None))
    plain = beside_preview(whole, tmp_path / "plain.dng", samples, 1)
    same(load_photo(packed), load_photo(plain))


@pytest.mark.parametrize("planes", [1, 3])
def test_reads_jpeg_xl(tmp_path, light, planes):
    pytest.importorskip("imagecodecs")
    samples = stored(light, planes)
    options = {"compression": JPEG_XL, "compressionargs": {"level": 0, "lossless": True}}
    photo = load_photo(write_dng(tmp_path / "a.dng", samples, **options))
    same(photo, load_photo(write_dng(tmp_path / "b.dng", samples)))


def test_a_truncated_copy_is_reported_by_the_original_name(tmp_path, light):
    path = write_dng(tmp_path / "a.dng", stored(light, 1), **TILED)
    path.write_bytes(path.read_bytes()[:-4000])
    with pytest.raises(MatcapError, match=r"a\.dng: the DNG file is truncated"):
        plain_dng(path, None)


def test_missing_extra_names_its_command(tmp_path, light, monkeypatch):
    path = write_dng(tmp_path / "a.dng", mosaic(light))
    data = path.read_bytes()
    # No encoder needed: the compression is written over, the picture never reached.
    at = data.index(b"\x03\x01\x03\x00\x01\x00\x00\x00\x01\x00") + 8
    path.write_bytes(data[:at] + JPEG_XL.to_bytes(2, "little") + data[at + 2 :])
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    with pytest.raises(MatcapError, match=r'pip install "matcap\[jxl\]"') as caught:
        load_photo(path)
    assert isinstance(caught.value.__cause__, ImportError)


# A DNG's lens shading: parsed, evaluated as the standard says, applied where it belongs.

SIZE = (96, 128)
PLACES = [(0, 0), (0, 1), (1, 0), (1, 1)]


@pytest.fixture
def grid() -> np.ndarray:
    """(5, 7, 1) gains that grow to the corners, and differ everywhere."""
    y, x = np.mgrid[-1:1:5j, -1:1:7j]
    return (1.0 + 0.8 * x**2 + 0.5 * y**2 + 0.1 * x)[..., None]


def reference_gain(grid: np.ndarray, row: int, column: int) -> float:
    """Chapter 7's words, one pixel at a time, for a map spread over the whole picture."""
    v = (row + 0.5) / SIZE[0] * (grid.shape[0] - 1)
    h = (column + 0.5) / SIZE[1] * (grid.shape[1] - 1)
    i, j = min(int(v), grid.shape[0] - 2), min(int(h), grid.shape[1] - 2)
    top = grid[i, j] * (1 - h + j) + grid[i, j + 1] * (h - j)
    bottom = grid[i + 1, j] * (1 - h + j) + grid[i + 1, j + 1] * (h - j)
    return float(top * (1 - v + i) + bottom * (v - i))


def test_gains_follow_the_standard(grid):
    opcodes = parse_opcodes(opcode_list(gain_map(grid, SIZE)))
    gains = Shading(opcodes.gain_maps, SIZE, SIZE).gains(10, 30, 1)
    assert not opcodes.changes
    for row, column in [(10, 0), (10, 127), (29, 64), (15, 33)]:
        expected = reference_gain(grid[..., 0], row, column)
        assert gains[row - 10, column, 0] == pytest.approx(expected, rel=1e-6)


def test_maps_touch_only_their_photosites():
    """Phones write a map for each place in the two by two."""
    flats = [np.full((1, 1, 1), gain) for gain in (1.5, 2.0, 3.0, 4.0)]
    both = zip(flats, PLACES, strict=True)
    opcodes = [gain_map(flat, SIZE, offset=place, pitch=2) for flat, place in both]
    maps = parse_opcodes(opcode_list(*opcodes)).gain_maps
    gains = Shading(maps, SIZE, SIZE).gains(0, 96, 1)[..., 0]
    np.testing.assert_array_equal(gains[:2, :2], [[1.5, 2.0], [3.0, 4.0]])
    np.testing.assert_array_equal(gains, np.tile(gains[:2, :2], (48, 64)))


@pytest.mark.parametrize("long_side", [None, 64])
def test_flat_field_comes_out_flat(tmp_path, grid, long_side):
    """A grey wall behind a lens with falloff; also where the gains lift it past the white level."""
    opcodes = opcode_list(gain_map(grid, SIZE))
    falloff = 1.0 / Shading(parse_opcodes(opcodes).gain_maps, SIZE, SIZE).gains(0, 96, 1)
    samples = mosaic(0.9 * falloff * NEUTRAL)
    path = write_dng(tmp_path / "a.dng", samples, neutral=NEUTRAL, opcodes2=opcodes)
    photo = load_photo(path, long_side=long_side)
    assert photo.gain_map_applied
    np.testing.assert_allclose(photo.pixels, 0.9, rtol=6e-3)
    assert photo.pixels.mean() == pytest.approx(0.9, rel=1e-3)
    plain = load_photo(write_dng(tmp_path / "b.dng", samples, neutral=NEUTRAL))
    assert not plain.gain_map_applied and plain.pixels.min() < 0.5


def test_a_gain_map_by_photosite_applies_to_its_colour(tmp_path):
    """Red photosites were shaded to a half, the others not."""
    opcodes = opcode_list(gain_map(np.full((1, 1, 1), 2.0), SIZE, pitch=2))
    light = np.full((*SIZE, 3), 0.4) * (0.5, 1.0, 1.0)
    photo = load_photo(write_dng(tmp_path / "a.dng", mosaic(light), opcodes2=opcodes))
    np.testing.assert_allclose(photo.pixels, 0.4, rtol=3e-3)


@pytest.mark.parametrize("option", ["opcodes2", "opcodes3"])
def test_linear_dng_by_plane(tmp_path, grid, option):
    tinted = np.concatenate([grid, 1.2 * grid, 1.5 * grid**2], axis=2)
    maps = parse_opcodes(opcode_list(gain_map(tinted, SIZE, planes=3))).gain_maps
    # The gains differ by plane, and are for the colours of a camera that mixes them.
    mixing = np.array([[0.8, 0.2, 0.0], [0.1, 0.8, 0.1], [0.0, 0.3, 0.7]])
    rec709 = np.array([0.4, 0.3, 0.2])
    light = rec709 @ mixing.T / Shading(maps, SIZE, SIZE).gains(0, 96, 3)
    samples = np.rint(BLACK + light * (WHITE - BLACK)).astype(np.uint16)
    options = {option: opcode_list(gain_map(tinted, SIZE, planes=3))}
    options["color_matrix"] = color_matrix(mixing)
    picture = load_photo(write_dng(tmp_path / "a.dng", samples, **options))
    assert picture.gain_map_applied
    inside = picture.pixels[~picture.clipped]
    assert len(inside) > 0.9 * picture.clipped.size
    np.testing.assert_allclose(inside, np.tile(rec709, (len(inside), 1)), rtol=2e-2)


@pytest.mark.parametrize("long_side", [None, 64])
def test_gain_maps_after_demosaicing_are_applied(tmp_path, long_side):
    y, x = np.mgrid[-1:1:3j, -1:1:3j]
    opcodes = opcode_list(gain_map((1.0 + 0.3 * x + 0.2 * y)[..., None], SIZE, planes=3))
    light = 0.4 / Shading(parse_opcodes(opcodes).gain_maps, SIZE, SIZE).gains(0, 96, 3)
    path = write_dng(tmp_path / "a.dng", mosaic(light), opcodes3=opcodes)
    photo = load_photo(path, long_side=long_side)
    assert photo.gain_map_applied
    np.testing.assert_allclose(photo.pixels[1:-1, 1:-1], 0.4, rtol=1e-2)


def test_gain_maps_after_demosaicing_apply_by_colour_and_above_white(tmp_path):
    gains = np.array([2.0, 1.5, 1.6])
    opcodes = opcode_list(gain_map(np.tile(gains, (2, 2, 1)), SIZE, planes=3))
    samples = mosaic(np.ones((*SIZE, 3)) * 1.2 / gains)
    path = write_dng(tmp_path / "a.dng", samples, opcodes3=opcodes)
    for long_side in (None, 64):
        photo = load_photo(path, long_side=long_side)
        np.testing.assert_allclose(photo.pixels, 1.2, rtol=2e-3)
        assert not photo.clipped.any()


def test_places_count_from_the_active_area(tmp_path, grid):
    """Behind an odd margin of masked pixels, which LibRaw makes even."""
    maps = [gain_map(grid * (1.5 if p == (0, 0) else 1.0), SIZE, offset=p, pitch=2) for p in PLACES]
    opcodes = opcode_list(*maps)
    gains = Shading(parse_opcodes(opcodes).gain_maps, SIZE, SIZE).gains(0, 96, 1)[..., 0]
    active = BLACK + (mosaic(np.full((*SIZE, 3), 0.5)) - float(BLACK)) / gains
    stored = np.zeros((96 + 3, 128 + 5), np.uint16)
    stored[3:, 5:] = np.rint(active)
    path = write_dng(tmp_path / "a.dng", stored, opcodes2=opcodes, active_area=(3, 5, 99, 133))
    picture = load_photo(path)
    assert min(picture.pixels.shape[:2]) >= SIZE[0] - 1
    np.testing.assert_allclose(picture.pixels, 0.5, rtol=4e-3)


@pytest.mark.parametrize(
    ("opcode", "named"), [(1, "distortion"), (3, "vignette"), (12, "rows"), (5, None)]
)
def test_opcodes_that_change_light_or_position_are_named(tmp_path, light, opcode, named):
    asked = opcode_list(struct.pack(">4I", opcode, 0x01030000, 0, 56) + bytes(56))
    photo = load_photo(write_dng(tmp_path / "a.dng", mosaic(light), opcodes3=asked))
    assert [named in note for note in photo.notes] == ([True] if named else [])


@pytest.mark.parametrize(
    "broken",
    [
        opcode_list(gain_map(np.ones((5, 5, 1)), SIZE))[:-8],
        opcode_list(gain_map(np.full((2, 2, 1), np.nan), SIZE)),
        opcode_list(gain_map(np.ones((2, 2, 1)), SIZE, pitch=0)),
        struct.pack(">I", 9),
    ],
    ids=["short", "nan", "pitch", "count"],
)
def test_broken_maps_are_refused(tmp_path, light, broken):
    path = write_dng(tmp_path / "a.dng", mosaic(light), opcodes2=broken)
    with pytest.raises(MatcapError, match="damaged"):
        load_photo(path)
