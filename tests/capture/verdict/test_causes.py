"""Measured causes of a verdict."""

import numpy as np
import pytest

from matcap.capture.verdict.causes import highlight_residue, in_rings
from matcap.example.exemplar import Exemplar
from matcap.flash.geometry import FlashSetup, camera_in_plane, flash_mirror_point

# Highlight residue, where there is some and where there is none.


SETUP = FlashSetup(offset=(0.2, -0.1, 0.0), tilt=(0.05, -0.03))
SIZE = (192, 144)


def piece(**changes):
    """Noise all over, and what is changed of it."""
    rng = np.random.default_rng(3)
    shape = SIZE[::-1]
    maps = {
        "diffuse": np.exp(rng.normal(-1.5, 0.2, (3, *shape))),
        "specular": np.exp(rng.normal(-3.0, 0.1, (1, *shape))),
        "roughness": rng.normal(0.5, 0.05, (1, *shape)),
        "height": rng.normal(0.0, 0.002, (1, *shape)),
        "confidence": np.ones((4, *shape)),
    }
    maps |= {name: change(maps[name]) for name, change in changes.items()}
    maps = {name: values.astype(np.float32) for name, values in maps.items()}
    return Exemplar(**maps, texel_size=2.0 / SIZE[0])


def away():
    x, y = flash_mirror_point(SETUP)
    width, height = SIZE
    v, u = np.mgrid[:height, :width] + 0.5
    return np.hypot(2.0 * u / width - 1.0 - x, (height - 2.0 * v) / width - y)


def test_the_mirror_point_is_where_a_mirror_shows_the_flash():
    x, y = flash_mirror_point(SETUP)
    camera, light = camera_in_plane(SETUP)
    beams = [np.array([x, y, 0.0]) - place.numpy() for place in (camera, light)]
    first, second = (beam / np.linalg.norm(beam) for beam in beams)
    assert first + second == pytest.approx([0.0, 0.0, (first + second)[2]], abs=1e-9)


def test_what_is_the_same_all_over_has_none():
    assert max(highlight_residue(piece(), SETUP).values()) < 0.03


@pytest.mark.parametrize(
    ("map_name", "mark"),
    [("diffuse", "albedo"), ("specular", "specular"), ("roughness", "roughness")],
)
def test_a_disc_is_told_in_its_map_alone(map_name, mark):
    disc = 0.1 * (away() < 0.5)

    def marked(values):
        return values + disc if mark == "roughness" else values * np.exp(disc)

    found = highlight_residue(piece(**{map_name: marked}), SETUP)
    # Rings of equal counts: six, and the disc has its share of them.
    share = float((away() < 0.5).mean())
    expected = 0.1 * np.sqrt(share * (1.0 - share))
    assert found.pop(mark) == pytest.approx(expected, rel=0.2) and max(found.values()) < 0.03


def test_grain_that_fades_towards_the_mirror_point_is_told():
    fading = np.minimum(away(), 0.8) / 0.8
    assert highlight_residue(piece(height=lambda height: height * fading), SETUP)["grain"] > 0.3


def test_a_stain_elsewhere_counts_for_little_and_chance_for_nothing():
    rng = np.random.default_rng(5)
    distances = rng.uniform(size=(18, 24))
    scatter = [in_rings(rng.normal(size=(18, 24)), distances) for _ in range(200)]
    # Of variances, chance adds nothing on the mean; cut off at 0 it is a little.
    assert np.mean(np.square(scatter)) < 0.01 and np.median(scatter) < 0.05
