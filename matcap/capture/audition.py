"""The decoder that a capture starts with: the prior's, or the best of a few random ones."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from matcap.capture.coarse import CoarseFit
from matcap.capture.finetune import (
    RATE_FROM_NOTHING,
    RATE_FROM_PRIOR,
    TuneScene,
    TuneSettings,
    finetune,
)
from matcap.capture.prior.store import load_prior
from matcap.capture.settings import CaptureSettings, Effort, Method
from matcap.capture.start import log_contrast, reading_cells, untrained
from matcap.flash.plane import Plane
from matcap.model.decoder import CODE_SIZE, Decoder
from matcap.model.regular_order import CELL_CHANNELS
from matcap.photo.photo import Photo

# From nothing, where a run ends depends on where it starts: the best of a few short runs goes on.
_AUDITIONS, _AUDITION_STEPS = 3, 40


@dataclass(frozen=True)
class Beginning:
    """Where fine-tuning starts.

    Attributes:
        decoder: to be tuned.
        code: (CODE_SIZE,) at which.
        rate: of learning.
    """

    decoder: Decoder
    code: Tensor
    rate: float


def begin(
    photo: Photo,
    coarse: CoarseFit,
    plane: Plane,
    scene: TuneScene,
    settings: CaptureSettings,
    effort: Effort,
    method: Method,
) -> Beginning:
    """Choose it.

    Args:
        photo: the photograph, as it is,
        coarse: its coarse fit, and
        plane: rectified.
        scene: what will be tuned to.
        settings: which prior, if any, and the seed.
        effort: how many steps there will be.
        method: shape and precision.

    Raises:
        MatcapError: the prior cannot be read.
    """
    if settings.prior == "none":
        decoder = _best_of_some(coarse, plane, scene, settings, effort, method)
        return Beginning(decoder, torch.zeros(CODE_SIZE), RATE_FROM_NOTHING)
    prior = load_prior(None if settings.prior == "auto" else Path(settings.prior))
    decoder, code = prior.start(photo, coarse, plane)
    if scene.waves and effort.steps:  # untuned, its weights would only add noise
        decoder = reading_cells(decoder, settings.seed)
    return Beginning(decoder.requires_grad_(True), code, RATE_FROM_PRIOR)


def _best_of_some(
    coarse: CoarseFit,
    plane: Plane,
    scene: TuneScene,
    settings: CaptureSettings,
    effort: Effort,
    method: Method,
) -> Decoder:
    """The most promising of a few random decoders, each tuned for a moment.

    Skipped when there is no time for it: the first one goes on then.
    """
    shape = replace(method.decoder, cells=CELL_CHANNELS if scene.waves else 0)
    contrast = log_contrast(plane.linear, plane.valid)
    if effort.steps < 4 * _AUDITIONS * _AUDITION_STEPS or settings.time_limit is not None:
        return untrained(shape, coarse, contrast, settings.seed)
    best, least = None, math.inf
    for seed in range(settings.seed, settings.seed + _AUDITIONS):
        tune = TuneSettings(
            steps=_AUDITION_STEPS,
            places=effort.places,
            learning_rate=RATE_FROM_NOTHING,
            half_precision=method.half_precision,
            seed=seed,
        )
        first = untrained(shape, coarse, contrast, seed)
        tried = finetune(first, torch.zeros(CODE_SIZE), scene, tune, _untold)
        error = tried.history[-1][2] if tried.history else math.inf
        if best is None or error < least:
            best, least = tried.decoder, error
        if tried.interrupted:
            raise KeyboardInterrupt
    assert best is not None
    return best


def _untold(share: float, error: float, seconds: float) -> None:
    """Nobody listens to an audition."""
