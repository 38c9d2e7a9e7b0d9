"""Large photographs in a few times the memory of their pixels."""

import subprocess
import sys

import numpy as np
from PIL import Image

from matcap.files.srgb import srgb_decode

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
