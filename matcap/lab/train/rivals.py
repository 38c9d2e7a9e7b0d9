"""What a capture of a real photograph must beat under that photograph's own flash.

None of them is relit here: a real photograph's material is not known under another light. That is
measured on simulated ones, by `matcap bench quality`.
"""

from __future__ import annotations

import time

import torch

from matcap.lab.bench.baselines import PerTexelSettings, per_texel, photo_as_albedo
from matcap.lab.bench.quilting import quilt
from matcap.lab.train.measure import DETAIL, SIZE, Made, Photographed, seeds


def albedo(shown: Photographed) -> Made:
    """The photograph as diffuse albedo (bench/baselines.py): its corner, laid in its middle.

    In its own place it would be compared with itself, lit a second time, and look right where no
    other piece of it would. There is one picture of it, so its diversity is 0.
    """
    began = time.perf_counter()
    fixed = photo_as_albedo(shown.photo, shown.scene.setup, DETAIL)
    seconds = time.perf_counter() - began
    corner = fixed.whole.crop(0, 0, SIZE, SIZE)
    return Made(shown.lit(corner, fixed.setup)[None], seconds)


def per_texel_maps(shown: Photographed, realisations: int, settings: PerTexelSettings) -> Made:
    """Maps optimised texel by texel (bench/baselines.py), with the coarse fit's setup.

    The patch is periodic; a realisation only moves it.
    """
    began = time.perf_counter()
    tiled = per_texel(shown.photo, shown.scene.setup, DETAIL, settings)
    seconds = time.perf_counter() - began
    maps = [tiled.maps(SIZE, SIZE, seed=seed) for seed in seeds(realisations)]
    return Made(torch.stack([shown.lit(each) for each in maps]), seconds)


def quilts(shown: Photographed, realisations: int) -> Made:
    """Quilts of the photograph's middle (bench/quilting.py): pictures, with the light in them.

    They are copies of the very texels they are compared with: what a picture without maps can
    reach at best.
    """
    began = time.perf_counter()
    source = shown.truth
    made = [quilt(source, SIZE, SIZE, seed) for seed in seeds(realisations)]
    return Made(torch.stack(made), (time.perf_counter() - began) / realisations)
