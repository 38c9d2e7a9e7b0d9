"""Downsampling: area means of light, never enlarged, in little memory."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from matcap.errors import UsageError
from matcap.files.srgb import srgb_decode
from matcap.photo import shrink as shrink_module
from matcap.photo.load import load_photo
from matcap.photo.shrink import shrink, shrunk_size


def reader(pixels, mask):
    return lambda top, bottom: (pixels[top:bottom], mask[top:bottom])


def area_matrix(size: int, new: int) -> np.ndarray:
    """(new, size): what share of each new pixel each old one covers."""
    edges = np.linspace(0, size, new + 1)
    old = np.arange(size)
    overlap = np.minimum(edges[1:, None], old + 1) - np.maximum(edges[:-1, None], old)
    return np.maximum(overlap, 0.0) * new / size


@settings(max_examples=30, deadline=None)
@given(st.integers(64, 200), st.integers(64, 200), st.integers(16, 199), st.integers(0, 999))
def test_is_the_area_mean(width, height, long_side, seed):
    rng = np.random.default_rng(seed)
    pixels = rng.random((height, width, 3)).astype(np.float32)
    mask = rng.random((height, width)) < 0.3
    small, _ = shrink(reader(pixels, mask), width, height, long_side)
    new_width, new_height = shrunk_size(width, height, long_side)
    assert small.shape == (new_height, new_width, 3)
    down, across = area_matrix(height, new_height), area_matrix(width, new_width)
    expected = np.einsum("ah,hwc,bw->abc", down, pixels, across, optimize=True)
    np.testing.assert_allclose(small, expected, atol=2e-5)


def test_strips_do_not_show(monkeypatch):
    pixels = np.random.default_rng(0).random((150, 200, 3)).astype(np.float32)
    mask = pixels[..., 0] > 0.8
    whole = shrink(reader(pixels, mask), 200, 150, 77)
    monkeypatch.setattr(shrink_module, "_STRIP_PIXELS", 1400)
    for one, other in zip(whole, shrink(reader(pixels, mask), 200, 150, 77), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(("sites", "clipped"), [(3, False), (4, True)])
def test_a_quarter_of_the_area_clips(sites, clipped):
    mask = np.zeros((128, 128), bool)
    mask.reshape(32, 4, 32, 4).swapaxes(1, 2).reshape(32, 32, 16)[...]  # a block is 16 pixels
    for site in range(sites):
        mask[site // 4 :: 4, site % 4 :: 4] = True
    pixels = np.ones((128, 128, 3), np.float32)
    assert (shrink(reader(pixels, mask), 128, 128, 32)[1] == clipped).all()


def test_the_mean_is_of_light_not_of_code_values(photo_of):
    stripes = np.zeros((128, 128, 3), np.uint8)
    stripes[:, ::2] = 200
    photo = photo_of(stripes, "a.png", long_side=64)
    np.testing.assert_allclose(photo.pixels, srgb_decode(np.array(200 / 255)) / 2, rtol=1e-5)


@given(st.integers(1, 4000), st.integers(1, 4000), st.integers(1, 5000))
def test_size_never_grows_and_keeps_its_shape(width, height, long_side):
    new_width, new_height = shrunk_size(width, height, long_side)
    assert 1 <= new_width <= width and 1 <= new_height <= height
    assert max(new_width, new_height) == min(long_side, max(width, height))


def test_portrait_is_turned_anticlockwise(photo_of, codes):
    portrait = np.ascontiguousarray(codes.swapaxes(0, 1))
    photo = photo_of(portrait, "a.png", long_side=64)
    assert photo.turned and photo.original_size == (96, 128)
    assert photo.pixels.shape == (48, 64, 3) and photo.clipped.shape == (48, 64)
    whole = photo_of(portrait, "a.png").pixels
    # Anticlockwise: the top right corner goes to the top left.
    np.testing.assert_allclose(whole[0, 0], srgb_decode(portrait[0, -1] / 255), rtol=1e-5)
    np.testing.assert_allclose(whole[-1, 0], srgb_decode(portrait[0, 0] / 255), rtol=1e-5)


@pytest.mark.parametrize("long_side", [0, -5, 63])
def test_too_short_a_long_side_is_a_usage_error(long_side):
    with pytest.raises(UsageError, match="long side"):
        load_photo("a.png", long_side=long_side)


# The high-water mark is the kernel's, of the child alone: C libraries do not tell tracemalloc.
SCRIPT = """
import sys
from matcap.photo.load import load_photo

def mebibytes(field):
    lines = open("/proc/self/status").read().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(field))

import cv2, exifread, PIL.Image
before = mebibytes("VmRSS")
photo = load_photo(sys.argv[1], long_side=int(sys.argv[2]))
assert photo.original_size == (int(sys.argv[3]), int(sys.argv[4])), photo.original_size
assert abs(float(photo.pixels.mean()) - float(sys.argv[5])) < 2e-3
print(mebibytes("VmHWM") - before)
"""


MEAN = float(srgb_decode(np.linspace(0.0, 1.0, 256)).mean())  # of a ramp from black to white


def test_50_megapixels_take_little_more_than_their_pixels(tmp_path):
    path = tmp_path / "large.jpg"
    gradient = Image.linear_gradient("L").resize((8000, 6250))
    Image.merge("RGB", (gradient,) * 3).save(path, quality=80)
    del gradient
    pixels = 8000 * 6250 * 3 / 2**20
    assert taken(path, 1024, (8000, 6250), MEAN) < 3 * pixels


def test_200_megapixels_are_read_within_2_gib(tmp_path):
    """As today's phones take them; shrunk while they are decoded."""
    path, size = tmp_path / "large.jpg", (16320, 12240)
    Image.linear_gradient("L").resize(size).save(path, quality=80)
    assert taken(path, 4000, size, MEAN) < 2048


def taken(path, long_side: int, size: tuple[int, int], mean: float) -> float:
    """MiB that reading a photograph takes at most, in a process of its own."""
    asked = [str(value) for value in (path, long_side, *size, mean)]
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *asked], capture_output=True, text=True, check=True
    )
    return float(done.stdout)
