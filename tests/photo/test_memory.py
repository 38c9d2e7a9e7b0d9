"""Large photographs in a few times the memory of their pixels."""

import subprocess
import sys

from PIL import Image

# The high-water mark is the kernel's, of the child alone: C libraries do not tell tracemalloc.
SCRIPT = """
import sys
from matcap.photo.load import load_photo

def mebibytes(field):
    lines = open("/proc/self/status").read().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(field))

import cv2, exifread, PIL.Image
before = mebibytes("VmRSS")
photo = load_photo(sys.argv[1], long_side=1024)
assert photo.original_size == (8000, 6250), photo.original_size
print(mebibytes("VmHWM") - before)
"""


def test_50_megapixels_take_little_more_than_their_pixels(tmp_path):
    path = tmp_path / "large.jpg"
    gradient = Image.linear_gradient("L").resize((8000, 6250))
    Image.merge("RGB", (gradient,) * 3).save(path, quality=80)
    del gradient
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(path)], capture_output=True, text=True, check=True
    )
    pixels = 8000 * 6250 * 3 / 2**20
    assert float(done.stdout) < 3 * pixels
