"""The field is one function, however it is read, and never repeats unless asked to."""

import numpy as np
import pytest
import torch
from draws import run
from repetition import correlations

from matcap.field.blocks import BLOCK
from matcap.field.field import Field
from matcap.field.plane import Rectangle
from matcap.space.noise import noise_field
from matcap.space.patch import Patch


def test_random_rectangles_orders_and_workers_give_the_same_bits(material):
    assert run(material, 60) == 60


def test_waves_are_the_same_bits_too(wavy):
    assert run(wavy, 20, seed=1) == 20


def test_a_periodic_field_is_itself_rolled(material):
    maps = Field(material, 3, (BLOCK + 16, 48)).read(0, 0, 2 * (BLOCK + 16), 96)
    for kind in ("diffuse", "specular", "roughness", "height"):
        one = getattr(maps, kind)
        assert torch.equal(one, one.roll((48, BLOCK + 16), (1, 2)))


def test_nothing_repeats(material):
    own, others = correlations(material, 768)
    assert max(own) < 1.2 * max(others)


def test_repetition_would_be_found(material):
    # A field of period 256 read as if it were endless.
    def read(seed):
        return Field(material, seed, (256, 256)).read(0, 0, 768, 768).roughness[0].numpy()

    one = read(1) - read(1).mean()
    correlation = np.fft.irfft2(np.abs(np.fft.rfft2(one)) ** 2, s=one.shape) / one.size / one.var()
    assert correlation[0, 256] > 0.99


@pytest.mark.parametrize("place", [0, 2**31, 2**40 - 256])
def test_the_hash_is_uniform_and_independent(place):
    """Chi-square, correlation and the sign patterns of neighbours, within five deviations."""
    noise = noise_field(Patch(5, Rectangle(place, -place, 256, 256)), 6).numpy()
    levels = np.floor((noise / 12**0.5 + 0.5) * 64).astype(int)
    for channel in levels:
        counts = np.bincount(channel.ravel(), minlength=64)
        expected = channel.size / 64
        assert abs(((counts - expected) ** 2 / expected).sum() - 63) < 5 * (2 * 63) ** 0.5
    deviation = 1 / 256
    others = noise_field(Patch(6, Rectangle(place, -place, 256, 256)), 6).numpy()
    for a in range(6):
        for shift in ((0, 1), (1, 0), (1, 1), (16, 0), (0, 64)):
            assert abs((noise[a] * np.roll(noise[a], shift, (0, 1))).mean()) < 5 * deviation
        assert abs((noise[a] * others[a]).mean()) < 5 * deviation
        for b in range(a):
            assert abs((noise[a] * noise[b]).mean()) < 5 * deviation


def test_every_bit_of_seed_and_place_changes_half_of_the_hash():
    one = noise_field(Patch(0, Rectangle(0, 0, 32, 32)), 4)
    for bit in (5, 20, 31, 39):
        for changed in (
            noise_field(Patch(2**bit, Rectangle(0, 0, 32, 32)), 4),
            noise_field(Patch(0, Rectangle(2**bit, 0, 32, 32)), 4),
            noise_field(Patch(0, Rectangle(0, -(2**bit), 32, 32)), 4),
        ):
            # The sign is a hash's top bit: it should be a coin's toss.
            assert abs(float((one.sign() != changed.sign()).float().mean()) - 0.5) < 0.05
