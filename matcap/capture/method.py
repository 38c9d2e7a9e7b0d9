"""Variants of the capture method for experiments; not user settings."""

from __future__ import annotations

from dataclasses import dataclass

from matcap.statistics.compare import FilterBankConfig, Weights

WINDOW = 160  # side of the windows whose texture statistics are compared, texels
FEATURES = FilterBankConfig(sizes=(5,), filters=64)


@dataclass(frozen=True)
class Method:
    """A variant of the capture method; by default the one that measured best."""

    weights: Weights = Weights()
    """Weights of the texture statistics in their sum."""
    measured_tilt: bool = True
    """Whether the alignment branch's tilt is a prior of the coarse fit."""
