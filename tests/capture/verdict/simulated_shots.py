"""Simulated photographs, one good and others as bad as users bring them."""

from dataclasses import replace
from functools import cache

import numpy as np
from simulated.materials import piece
from simulated.photographs import PhoneCamera, as_photo, take, true_maps

from matcap.brdf.maps import MapSet
from matcap.flash.geometry import FlashSetup

CAMERA = PhoneCamera(width=384, height=288, supersampling=1, blur=0.5)
SETUP = FlashSetup(offset=(0.05, 0.04, 0.0), tilt=(0.02, -0.01), vignetting=0.02)


@cache
def shot(name):
    """A photograph under its flash, and what is true of it."""
    return take(piece(name, 3), CAMERA, SETUP)


@cache
def good(name):
    """A photograph as it should be."""
    return as_photo(shot(name), 1, f"{name}.dng")


@cache
def maps(name, seed=3):
    """The true maps of what the photograph shows, or of another piece of the material."""
    truth = true_maps(piece(name, seed), CAMERA)
    return MapSet.from_stacked(truth.stacked().float(), truth.texel_size)


def without_flash(name):
    """The same surface in even light."""
    albedo = maps(name).diffuse.movedim(0, -1).numpy()
    return _of(good(name), 0.2 * albedo / albedo.mean(), flash_fired=False)


def with_lamp(name, strength=10.0):
    """A lamp at the side, by default ten times as bright as the flash."""
    photo = good(name)
    across = np.linspace(0.0, 1.0, photo.pixels.shape[1], dtype=np.float32)[None, :, None]
    albedo = maps(name).diffuse.movedim(0, -1).numpy()
    lit = photo.pixels + strength * photo.pixels.mean() * albedo / albedo.mean() * across**2
    return _of(photo, 0.2 * lit / lit.mean())


def in_a_lit_room(name):
    """Twice as much even light as the flash's."""
    photo = good(name)
    albedo = maps(name).diffuse.movedim(0, -1).numpy()
    return _of(photo, 0.4 * (photo.pixels + 2.0 * photo.pixels.mean() * albedo / albedo.mean()))


def too_red(name):
    """Exposed so long that red clips, and little else."""
    photo = good(name)
    return _of(photo, photo.pixels * np.array([3.0, 1.0, 1.0]))


def with_streak(name):
    """A highlight three times as long as wide, as of brushed metal."""
    photo = good(name)
    height, width = photo.pixels.shape[:2]
    y, x = (np.mgrid[:height, :width] * 2.0 - [[[height]], [[width]]]) / width
    streak = 0.35 * np.exp(-0.5 * ((x / 0.07) ** 2 + (y / 0.21) ** 2))
    return _of(photo, 0.5 * photo.pixels + streak[..., None])


def painting():
    """A picture of patches that is no one material, under a good flash."""
    photo = good("plaster")
    rng = np.random.default_rng(5)
    patches = rng.uniform(0.05, 1.0, (3, 4, 3)).repeat(96, axis=0).repeat(96, axis=1)
    grain = np.exp(rng.normal(0.0, np.array([0.02, 0.1, 0.4, 0.8]).repeat(96)[None, :, None],
                              photo.pixels.shape))  # fmt: skip
    return _of(photo, photo.pixels * patches * grain)


def _of(photo, pixels, **changes):
    pixels = np.clip(pixels, 0.0, 1.0).astype(np.float32)
    return replace(photo, pixels=pixels, clipped=(pixels >= 1.0).any(axis=-1), **changes)
