"""Noise is no texture: renderings get it before they are compared with a noisy photograph."""

from dataclasses import replace

import torch
from tuning import HEIGHT, WIDTH, WINDOW, photograph, scene, tune
from uniform import a_setup
from uniform import photograph as uniform

from matcap.flash.plane import Plane
from matcap.flash.rectify import rectify, rectify_noise
from matcap.space.tuning.likeness import with_noise
from matcap.space.tuning.windows import cut_windows, shot_deviation
from matcap.statistics.compare import Weights, describe, distance
from matcap.statistics.encoding import fit_encoding
from matcap.statistics.filterbank import FilterBank, FilterBankConfig

BANK = FilterBank(FilterBankConfig(sizes=(3,), filters=8, levels=3))
VALID = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)


def draw(linear, seed, strength=0.1):
    """Shot noise."""
    generator = torch.Generator().manual_seed(seed)
    return strength * linear.sqrt() * torch.randn(linear.shape, generator=generator)


def test_the_truth_is_nearest_when_its_noise_is_drawn_too():
    clean = photograph()
    noisy = clean + draw(clean, 1)
    encoding = fit_encoding(noisy, VALID)
    windows = cut_windows(Plane(noisy, VALID, draw(clean, 2), encoding), BANK, WINDOW)
    places = [(x, y) for y in (0, 16) for x in (0, 24, 48)]
    rendered = torch.stack([clean[:, y : y + WINDOW, x : x + WINDOW] for x, y in places])
    assert windows.noise.shape == rendered.shape

    def apart(pictures):
        found = describe(pictures, encoding, BANK)
        return float(distance(found, windows.target, Weights()).mean())

    assert apart(with_noise(rendered, windows.noise, 3)) < 0.75 * apart(rendered)


def test_what_is_noise_alone_is_not_amplified():
    """Grey texture with coloured noise: without knowing better, colour is scaled up."""
    clean = photograph().mean(dim=0, keepdim=True).expand(3, -1, -1)
    noisy = clean + draw(clean, 1, 0.2)
    both = [fit_encoding(noisy, VALID), fit_encoding(noisy, VALID, draw(clean, 2, 0.2))]
    colour, grey = torch.tensor([1.0, -1.0, 0.0]), torch.ones(3)
    amplified = [
        float((each.matrix @ colour).norm() / (each.matrix @ grey).norm()) for each in both
    ]
    assert amplified[1] < 0.6 * amplified[0]


def test_no_noise_changes_nothing_and_all_noise_does_no_harm():
    linear = photograph()
    plain = fit_encoding(linear, VALID)
    none = fit_encoding(linear, VALID, torch.zeros_like(linear))
    torch.testing.assert_close(plain.matrix, none.matrix)
    flat = torch.full_like(linear, 0.3)
    only = fit_encoding(flat + draw(flat, 1, 0.05), VALID, draw(flat, 2, 0.08))
    assert bool(torch.isfinite(only.matrix).all())


def test_noise_is_moved_and_follows_the_light():
    rendered = photograph()[None, :, :WINDOW, :WINDOW]
    share = torch.randn(rendered.shape, generator=torch.Generator().manual_seed(0))
    first, second = (with_noise(rendered, share, step) for step in (1, 2))
    assert not torch.equal(first, second)
    assert torch.equal(first, with_noise(rendered, share, 1))
    added = (first - rendered) / shot_deviation(rendered)
    torch.testing.assert_close(
        added.abs().flatten(2).sort().values,
        share.abs().flatten(2).sort().values,
        atol=1e-4,
        rtol=1e-4,
    )


def test_noise_is_rectified_as_the_picture_is():
    setup = a_setup(tilt=(0.15, -0.1))
    photo = uniform(setup)
    assert rectify_noise(photo, setup, 96) is None
    both = replace(photo, noise=photo.pixels - 0.01)
    linear, valid = rectify(both, setup, 96)
    noise = rectify_noise(both, setup, 96)
    torch.testing.assert_close(noise[:, valid], linear[:, valid] - 0.01, atol=1e-5, rtol=0.0)


def test_tuning_takes_the_noise_and_stays_the_same_every_time():
    seen = scene()
    noise = torch.randn(seen.windows.points.shape, generator=torch.Generator().manual_seed(0))
    noisy = replace(seen, windows=replace(seen.windows, noise=0.05 * noise))
    first, again, without = (tune(steps=4, seen=one).history for one in (noisy, noisy, seen))
    assert [one[2] for one in first] == [one[2] for one in again]
    assert [one[2] for one in first] != [one[2] for one in without]
