"""Variants of the capture method for experiments; not user settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from matcap.statistics.compare import Weights
from matcap.statistics.filterbank import FilterBankConfig

if TYPE_CHECKING:
    from matcap.space.decoder import DecoderConfig

WINDOW = 160  # side of the windows whose texture statistics are compared, texels
FEATURES = FilterBankConfig(sizes=(5,), filters=64)


@dataclass(frozen=True)
class Method:
    """A variant of the capture method; by default the one that measured best."""

    window: int = WINDOW
    """Side of the compared windows, texels."""
    features: FilterBankConfig = FEATURES
    """Filter bank of the texture statistics."""
    decoder: DecoderConfig | None = None
    """Layers of the decoder without a prior, which would determine them."""
    half_precision: bool = True
    """Compute network and features in bfloat16 if the processor supports it."""
    places: int | None = None
    """Windows per step of fine-tuning; None: the preset's."""
    matched: bool | None = None
    """Whether to match mean and contrast after fine-tuning; None: the preset's."""
    weights: Weights = Weights()
    """Weights of the texture statistics in their sum."""
    measured_tilt: bool = True
    """Whether the alignment branch's tilt is a prior of the coarse fit."""
