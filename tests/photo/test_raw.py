"""RAW: linear, balanced, oriented once, clipping read off the mosaic, by quiet decoders."""

import subprocess
import sys

import numpy as np
import pytest
from simulated.files import BLACK, WHITE, color_matrix, mosaic, write_dng

from matcap.photo.load import load_photo

NEUTRAL = (0.5, 1.0, 0.6)
MIXING = np.array([[0.7, 0.25, 0.05], [0.2, 0.7, 0.1], [0.05, 0.25, 0.7]])


def test_slope_is_one_and_offset_none(tmp_path):
    levels = np.linspace(0.02, 0.9, 12)
    light = np.repeat(levels, 16)[None, :, None] * np.ones((96, 1, 3))
    photo = load_photo(write_dng(tmp_path / "ramp.dng", mosaic(light)))
    measured = photo.pixels[:, 8::16].mean(axis=0)
    for channel in range(3):
        slope, offset = np.polyfit(levels, measured[:, channel], 1)
        assert slope == pytest.approx(1.0, abs=1e-3)
        assert offset == pytest.approx(0.0, abs=3e-4)
    assert photo.radiometric


def test_white_balance_comes_from_as_shot_neutral(tmp_path):
    grey = np.full((96, 128, 3), 0.4)
    photo = load_photo(write_dng(tmp_path / "a.dng", mosaic(grey * NEUTRAL), neutral=NEUTRAL))
    np.testing.assert_allclose(photo.pixels, 0.4, atol=1e-3)
    other = load_photo(write_dng(tmp_path / "b.dng", mosaic(grey * NEUTRAL)))
    np.testing.assert_allclose(other.pixels.mean((0, 1)), 0.4 * np.array(NEUTRAL), atol=1e-3)


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


def test_colors_come_out_of_the_camera_s(tmp_path):
    rec709 = np.zeros((96, 128, 3))
    rec709[:, :64], rec709[:, 64:] = (0.5, 0.2, 0.1), (0.1, 0.3, 0.6)
    samples = mosaic(rec709 @ MIXING.T * NEUTRAL)
    options = {"neutral": NEUTRAL, "color_matrix": color_matrix(MIXING)}
    photo = load_photo(write_dng(tmp_path / "a.dng", samples, **options))
    inner = np.r_[4:60, 68:124]
    np.testing.assert_allclose(photo.pixels[4:-4, inner], rec709[4:-4, inner], atol=1.5e-3)


def test_what_the_colour_matrix_lifts_past_one_is_kept(tmp_path):
    """No photosite is at its limit; Rec.709 red is over 1, and nothing cuts it off."""
    rec709 = np.full((96, 128, 3), 0.3)
    rec709[:, :64, 0] = 1.15
    samples = mosaic(rec709 @ MIXING.T)
    assert samples.max() < 0.98 * WHITE
    photo = load_photo(write_dng(tmp_path / "a.dng", samples, color_matrix=color_matrix(MIXING)))
    np.testing.assert_allclose(photo.pixels[4:-4, 4:60], rec709[4:-4, 4:60], atol=2e-3)
    assert not photo.clipped.any()


def test_half_size_agrees_with_whole(tmp_path, light):
    path = write_dng(tmp_path / "a.dng", mosaic(light * NEUTRAL), neutral=NEUTRAL)
    whole = load_photo(path).pixels.reshape(48, 2, 64, 2, 3).mean((1, 3))
    half = load_photo(path, long_side=64)
    assert half.original_size == (128, 96)
    # A mosaic's quad has its colours in different corners: the ramp moves by half a pixel.
    np.testing.assert_allclose(half.pixels[1:-1, 1:-1], whole[1:-1, 1:-1], atol=6e-3)


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
    assert photo.clipped[:, :62].all()
    assert not photo.clipped[:, 66:].any()
    assert photo.pixels.max() <= 1.0


def test_clip_mask_of_half_size(tmp_path):
    light = np.full((96, 128, 3), 0.3)
    light[40:60, 50:80] = 1.0
    photo = load_photo(write_dng(tmp_path / "a.dng", mosaic(light)), long_side=64)
    expected = np.zeros((48, 64), bool)
    expected[20:30, 25:40] = True
    np.testing.assert_array_equal(photo.clipped, expected)


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


def test_odd_sizes(tmp_path):
    light = np.full((97, 131, 3), 0.3)
    path = write_dng(tmp_path / "a.dng", mosaic(light))
    for long_side, shape in [(None, (97, 131)), (65, (48, 65)), (100, (74, 100))]:
        photo = load_photo(path, long_side=long_side)
        assert photo.pixels.shape == (*shape, 3)
        np.testing.assert_allclose(photo.pixels, 0.3, atol=1e-3)


SCRIPT = """
import logging, os, sys, threading
from matcap.files.quiet import quiet_decoders

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


def test_only_decoders_are_silenced():
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True
    )
    assert done.stderr == "progress\nafter\nand again\n"


def test_process_without_stderr():
    script = "import os; os.close(2)\nfrom matcap.files.quiet import quiet_decoders\n"
    script += "with quiet_decoders(): print('read')"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout == "read\n"


def test_a_cut_raw_prints_nothing(tmp_path):
    path = write_dng(tmp_path / "a.dng", mosaic(np.full((96, 128, 3), 0.4)))
    path.write_bytes(path.read_bytes()[:9000])
    script = "import sys, matcap.photo.load as load\nfrom matcap.errors import MatcapError\n"
    script += "try: load.load_photo(sys.argv[1])\nexcept MatcapError as error: print(error)"
    done = subprocess.run([sys.executable, "-c", script, str(path)], capture_output=True, text=True)
    assert done.stderr == "" and "truncated or damaged" in done.stdout
