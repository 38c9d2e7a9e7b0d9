"""Pictures to store in files: textured, coloured, and different at every corner."""

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from matcap.photo.load import load_photo

sys.path.insert(0, str(Path(__file__).parent))  # icc_files


@pytest.fixture
def codes() -> np.ndarray:
    """(96, 128, 3) uint8 with smooth gradients, no symmetry, nothing clipped."""
    y, x = np.mgrid[0:96, 0:128]
    red = 20 + 200 * x / 127
    green = 30 + 150 * y / 95
    blue = 120 + 60 * np.sin(x / 9) * np.cos(y / 7)
    return np.rint(np.stack([red, green, blue], axis=-1)).astype(np.uint8)


@pytest.fixture
def light() -> np.ndarray:
    """(96, 128, 3) linear camera colours, smooth, between 0.05 and 0.8."""
    y, x = np.mgrid[0:96, 0:128]
    ramp = 0.05 + 0.7 * x / 127 * (0.6 + 0.4 * y / 95)
    return np.stack([ramp, 0.8 * ramp, 0.5 * ramp + 0.1], axis=-1)


@pytest.fixture
def photo_of(tmp_path):
    """Save a picture, an array or Pillow's, under a name and read it as a photograph."""

    def saved(picture, name, *, long_side=None, fov=None, **options):
        image = picture if isinstance(picture, Image.Image) else Image.fromarray(picture)
        image.save(tmp_path / name, **options)
        return load_photo(tmp_path / name, long_side=long_side, fov=fov)

    return saved
