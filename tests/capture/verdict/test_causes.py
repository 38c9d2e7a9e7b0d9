"""Measured causes of a verdict."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from matcap.brdf.maps import MapSet
from matcap.capture.verdict.causes import highlight_residue, in_rings, steepness
from matcap.capture.verdict.measurements import connectivity
from matcap.example.exemplar import Exemplar
from matcap.flash.geometry import FlashSetup, camera_in_plane, flash_mirror_point

# Connectivity of a net of lines, of its inverse, and of noise of the same spectrum.


SIZE = (512, 768)
SEEN = np.ones(SIZE, bool)


def net(seed, size=SIZE, cell=24):
    """Dark lines between the bright cells of random points [worley1996]."""
    rng = np.random.default_rng(seed)
    points = np.ones(size, np.uint8)
    count = size[0] * size[1] // cell**2
    points[rng.integers(0, size[0], count), rng.integers(0, size[1], count)] = 0
    _, label = cv2.distanceTransformWithLabels(
        points, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    edges = np.zeros(size, np.uint8)
    edges[:, 1:] |= label[:, 1:] != label[:, :-1]
    edges[1:] |= label[1:] != label[:-1]
    far = cv2.distanceTransform(1 - edges, cv2.DIST_L2, 5)
    return -np.exp(-((far / 3.0) ** 2)).astype(np.float32)


def scrambled(picture, seed):
    """The same power spectrum with the phases of noise."""
    noise = np.random.default_rng(seed).normal(size=picture.shape)
    phases = np.exp(1j * np.angle(np.fft.rfft2(noise)))
    return np.fft.irfft2(np.abs(np.fft.rfft2(picture)) * phases, picture.shape).astype(np.float32)


def test_another_part_of_a_net_hangs_together_alike():
    before, after = connectivity((net(1), net(2)), SEEN)
    assert before > 1.5 and abs(after - before) < np.log(3.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_net_with_the_phases_of_noise_is_none(sign):
    before, after = connectivity((sign * net(1), sign * scrambled(net(1), 3)), SEEN)
    assert sign * before > 1.5 and abs(after) < 0.6
    assert abs(after - before) > np.log(8.0)


def test_bright_lines_count_against_dark_ones():
    dark, bright = connectivity((net(1), -net(1)), SEEN)
    assert bright == pytest.approx(-dark, abs=0.1)


def test_pictures_of_any_width_are_compared_at_one():
    fine = tuple(cv2.resize(net(n, (768, 1024)), (2048, 1536)) for n in (1, 2))
    small = connectivity((net(1, (768, 1024)), net(2, (768, 1024))), np.ones((768, 1024), bool))
    assert connectivity(fine, np.ones((1536, 2048), bool)) == pytest.approx(small, abs=0.2)


def test_only_what_is_seen_is_compared():
    after = net(1)
    after[:, :384] = scrambled(net(1), 3)[:, :384]
    before, same = connectivity((net(1), after), np.arange(768)[None, :].repeat(512, 0) >= 384)
    assert same == before
    assert connectivity((net(1), after), ~SEEN) is None
    tiny = net(1)[:100]
    assert connectivity((tiny, tiny), SEEN[:100]) is None


# Highlight residue and steepness, where there is some and where there is none.


SETUP = FlashSetup(offset=(0.2, -0.1, 0.0), tilt=(0.05, -0.03))
EXEMPLAR_MEASUREMENTS_SIZE = (192, 144)
TEXEL = 0.002
ALONG = torch.arange(384.0)


def piece(**changes):
    """Noise all over, and what is changed of it."""
    rng = np.random.default_rng(3)
    shape = EXEMPLAR_MEASUREMENTS_SIZE[::-1]
    maps = {
        "diffuse": np.exp(rng.normal(-1.5, 0.2, (3, *shape))),
        "specular": np.exp(rng.normal(-3.0, 0.1, (1, *shape))),
        "roughness": rng.normal(0.5, 0.05, (1, *shape)),
        "height": rng.normal(0.0, 0.002, (1, *shape)),
        "confidence": np.ones((4, *shape)),
    }
    maps |= {name: change(maps[name]) for name, change in changes.items()}
    maps = {name: values.astype(np.float32) for name, values in maps.items()}
    return Exemplar(**maps, texel_size=2.0 / EXEMPLAR_MEASUREMENTS_SIZE[0])


def away():
    x, y = flash_mirror_point(SETUP)
    v, u = np.mgrid[: EXEMPLAR_MEASUREMENTS_SIZE[1], : EXEMPLAR_MEASUREMENTS_SIZE[0]] + 0.5
    return np.hypot(
        2.0 * u / EXEMPLAR_MEASUREMENTS_SIZE[0] - 1.0 - x,
        (EXEMPLAR_MEASUREMENTS_SIZE[1] - 2.0 * v) / EXEMPLAR_MEASUREMENTS_SIZE[0] - y,
    )


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
    assert found.pop(mark) == pytest.approx(expected, rel=0.2)
    assert max(found.values()) < 0.03


def test_grain_that_fades_towards_the_mirror_point_is_told():
    fading = np.minimum(away(), 0.8) / 0.8
    assert highlight_residue(piece(height=lambda height: height * fading), SETUP)["grain"] > 0.3


def test_a_stain_elsewhere_counts_for_little_and_chance_for_nothing():
    rng = np.random.default_rng(5)
    distances = rng.uniform(size=(18, 24))
    scatter = [in_rings(rng.normal(size=(18, 24)), distances) for _ in range(200)]
    # Of variances, chance adds nothing on the mean; cut off at 0 it is a little.
    assert np.mean(np.square(scatter)) < 0.01
    assert np.median(scatter) < 0.05


def relief(slow, fine, phase=0.0):
    """Maps with waves of 32 and of 3 texels, of these amplitudes in texels, in both directions."""
    along = slow * torch.sin(math.tau * ALONG / 32.0 + phase) + fine * torch.sin(ALONG * 2.1)
    height = TEXEL * (along[None, :, None] + along[None, None, :])
    return MapSet(*(torch.full((count, 384, 384), 0.5) for count in (3, 1, 1)), height, TEXEL)


def test_it_is_of_slow_waves_however_fine_grain_is():
    assert steepness(relief(3.0, 0.1, 1.0), relief(1.0, 0.1)) == pytest.approx(3.0, rel=0.05)
    assert steepness(relief(1.0, 0.1), relief(3.0, 0.1)) == pytest.approx(1.0 / 3.0, rel=0.05)
    assert steepness(relief(1.0, 0.02), relief(1.0, 0.1)) == pytest.approx(1.0, rel=0.02)


def test_what_no_eye_sees_is_no_relief_and_relief_of_stains_is():
    assert steepness(relief(0.01, 0.1), relief(0.0, 0.1)) < 1.1
    assert steepness(relief(0.2, 0.1), relief(0.0, 0.0)) > 3.0


def test_without_any_relief_and_in_small_maps_it_is_not_known():
    flat = relief(0.0, 0.0)
    assert math.isnan(steepness(flat, flat))
    small = replace(flat, **{
        name: getattr(relief(1.0, 0.1), name)[:, :64, :64]
        for name in ("diffuse", "specular", "roughness", "height")
    })  # fmt: skip
    assert math.isnan(steepness(small, small))
