"""What no fit of offset and tilt can do better than."""

import math
from dataclasses import replace

import numpy as np
import pytest
from uniform import a_setup, photograph

from matcap.flash.coarse import fit_coarse
from matcap.lab.bench.place_floor import place_floors

pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit.script:DeprecationWarning")


def floors(red=1.0, rest=1.0, **material):
    """Of a plane with blotches of 20 %, stronger or weaker in red and in the other channels."""
    setup = a_setup(offset=(0.1, 0.05, 0.0), tilt=(0.05, 0.0), intensity=8.0)
    photo = photograph(setup, **material)
    height, width = photo.pixels.shape[:2]
    coarse = np.random.default_rng(3).normal(0.0, 0.2, (height // 4 + 1, width // 4 + 1))
    blotches = np.kron(coarse, np.ones((4, 4)))[:height, :width, None]
    pixels = photo.pixels * np.exp(blotches * (red, rest, rest))
    photo = replace(photo, pixels=pixels.astype(np.float32))
    return place_floors(photo, fit_coarse(photo), setup)


def test_texture_that_channels_share_hides_the_place_and_of_one_alone_does_not():
    brightness, channels = floors(diffuse=(0.25, 0.25, 0.25))
    assert channels.offset == pytest.approx(brightness.offset, rel=0.1)
    told_brightness, told = floors(red=1.0, rest=0.0)
    assert told.offset < 0.5 * told_brightness.offset and told.tilt < 0.5 * told_brightness.tilt


def test_more_texture_raises_the_floor_up_to_what_is_known_before():
    little, much = floors(red=0.2, rest=0.2)[0], floors(red=5.0, rest=5.0)[0]
    assert little.offset < 0.5 * much.offset
    known = math.sqrt(2.0 * math.log(2.0)) * 0.086
    assert much.offset < known
