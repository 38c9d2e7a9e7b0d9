"""The decoder that fine-tuning starts from: the prior's, or a random one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.plane import Plane
from matcap.space.decoder import CODE_SIZE, Decoder, DecoderConfig
from matcap.space.lattice_channels import CELL_CHANNELS
from matcap.space.prior.store import load_prior
from matcap.space.tuning.finetune import RATE_FROM_NOTHING, RATE_FROM_PRIOR, TuneSettings
from matcap.space.tuning.likeness import PhotographTarget
from matcap.space.tuning.start import log_contrast, reading_cells, untrained


@dataclass(frozen=True)
class InitialDecoder:
    """Initial state of fine-tuning."""

    decoder: Decoder
    code: Tensor
    """(CODE_SIZE,) latent vector."""
    rate: float
    """Learning rate."""


def initial_decoder(
    pixels: NDArray[np.float32],
    coarse: CoarseFit,
    plane: Plane,
    target: PhotographTarget,
    tune: TuneSettings,
    prior: str,
    shape: DecoderConfig,
) -> InitialDecoder:
    """Choose the decoder, latent vector and learning rate that fine-tuning starts from.

    Args:
        pixels: (H, W, 3) linear, of the photograph as taken.
        coarse, plane: of the photograph, the plane at the capture's resolution.
        prior: "auto" (the shipped one), "none" (a random decoder) or a file.
        shape: configuration of a random decoder.

    Raises:
        MatcapError: the prior cannot be read.
    """
    if prior == "none":
        shape = replace(shape, cells=CELL_CHANNELS if target.waves else 0)
        contrast = log_contrast(plane.linear, plane.valid)
        decoder = untrained(shape, coarse, contrast, tune.seed)
        return InitialDecoder(decoder, torch.zeros(CODE_SIZE), RATE_FROM_NOTHING)
    trained = load_prior(None if prior == "auto" else Path(prior))
    decoder, code = trained.start(pixels, coarse, plane)
    if target.waves and tune.steps:  # without a step, random weights would only add noise
        decoder = reading_cells(decoder, tune.seed)
    return InitialDecoder(decoder.requires_grad_(True), code, RATE_FROM_PRIOR)
