"""The decoder that a capture starts with: the prior's, or the best of a few random ones."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.flash.coarse import CoarseFit
from matcap.flash.likeness import PhotographTarget
from matcap.flash.plane import Plane
from matcap.space.decoder import CODE_SIZE, Decoder, DecoderConfig
from matcap.space.prior.store import load_prior
from matcap.space.regular_order import CELL_CHANNELS
from matcap.space.tuning.finetune import RATE_FROM_NOTHING, RATE_FROM_PRIOR, TuneSettings, finetune
from matcap.space.tuning.start import log_contrast, reading_cells, untrained

# From nothing, where a run ends depends on where it starts: the best of a few short runs goes on.
_CANDIDATES, _CANDIDATE_STEPS = 3, 40


@dataclass(frozen=True)
class Beginning:
    """Where fine-tuning starts."""

    decoder: Decoder
    """To be tuned."""
    code: Tensor
    """(CODE_SIZE,) at which."""
    rate: float
    """Of learning."""


def begin(
    pixels: NDArray[np.float32],
    coarse: CoarseFit,
    plane: Plane,
    target: PhotographTarget,
    tune: TuneSettings,
    prior: str,
    shape: DecoderConfig,
    *,
    hurried: bool = False,
) -> Beginning:
    """Choose it.

    Args:
        pixels: (H, W, 3) of the photograph, as it is.
        coarse: its coarse fit, and
        plane: rectified.
        target: what will be tuned to.
        tune: how.
        prior: "auto" (the one that comes with matcap), "none" (start from nothing) or a file.
        shape: of the decoder, where there is no prior to say it.
        hurried: there is no time for an initialisation search.

    Raises:
        MatcapError: the prior cannot be read.
    """
    if prior == "none":
        decoder = _best_of_some(coarse, plane, target, tune, shape, hurried)
        return Beginning(decoder, torch.zeros(CODE_SIZE), RATE_FROM_NOTHING)
    trained = load_prior(None if prior == "auto" else Path(prior))
    decoder, code = trained.start(pixels, coarse, plane)
    if target.waves and tune.steps:  # untuned, its weights would only add noise
        decoder = reading_cells(decoder, tune.seed)
    return Beginning(decoder.requires_grad_(True), code, RATE_FROM_PRIOR)


def _best_of_some(
    coarse: CoarseFit,
    plane: Plane,
    target: PhotographTarget,
    tune: TuneSettings,
    shape: DecoderConfig,
    hurried: bool,
) -> Decoder:
    """The most promising of a few random decoders, each tuned for a moment.

    Skipped when there is no time for it: the first one goes on then.
    """
    shape = replace(shape, cells=CELL_CHANNELS if target.waves else 0)
    contrast = log_contrast(plane.linear, plane.valid)
    if tune.steps < 4 * _CANDIDATES * _CANDIDATE_STEPS or hurried:
        return untrained(shape, coarse, contrast, tune.seed)
    best, least = None, math.inf
    for seed in range(tune.seed, tune.seed + _CANDIDATES):
        short = replace(
            tune, steps=_CANDIDATE_STEPS, learning_rate=RATE_FROM_NOTHING, target=None, seed=seed
        )
        first = untrained(shape, coarse, contrast, seed)
        tried = finetune(first, torch.zeros(CODE_SIZE), target, short, _untold)
        error = tried.history[-1][2] if tried.history else math.inf
        if best is None or error < least:
            best, least = tried.decoder, error
        if tried.interrupted:
            raise KeyboardInterrupt
    assert best is not None
    return best


def _untold(share: float, error: float, seconds: float) -> None:
    """Ignore the progress of the initialisation search."""
