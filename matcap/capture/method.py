"""Switches of a capture's method for experiments; not user settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from matcap.capture.together.texels import SolveSettings
from matcap.statistics.compare import Weights
from matcap.statistics.filterbank import FilterBankConfig

if TYPE_CHECKING:
    from matcap.space.decoder import DecoderConfig

FEATURES = FilterBankConfig(sizes=(5,), filters=64)


@dataclass(frozen=True)
class Method:
    """How it is done."""

    window: int = 160
    """Texels a side of what is compared; many cheap steps beat few exact ones."""
    features: FilterBankConfig = FEATURES
    """That textures are compared by."""
    decoder: DecoderConfig | None = None
    """Shape of the decoder, where there is no prior to say it."""
    half_precision: bool = True
    """bfloat16 inside the network and the features, where the processor computes with it."""
    places: int | None = None
    """Windows a step, instead of the preset's."""
    matched: bool | None = None
    """At the end, instead of as the preset says."""
    adapted: int | None = None
    """Steps of the exemplar, instead of the preset's."""
    weights: Weights = Weights()
    """Of the statistics that textures are compared by."""
    solving: SolveSettings = SolveSettings()
    """Of several photographs."""
    measured_tilt: bool = True
    """Whether the alignment branch is asked."""
