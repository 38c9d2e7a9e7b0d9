"""Batch renormalisation [ioffe2017] of AdaIN, for windows smaller than the texture's variation.

AdaIN normalises every window by its own moments M, S, which removes what one window has and another
has not: the clouds of a drawing. With running moments m, s over all windows so far, it is undone:

    (x - M) / S * r + d,    r = S / s,    d = (M - m) / s,

where r and d are constants of the gradient, which therefore is AdaIN's and as stable; the values
are those of frozen statistics. At first r = 1 and d = 0; their limits widen with the steps.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.space.decoder import EPSILON, ConvolutionLayer, Decoder
from matcap.space.random_field import RandomField

_NEWEST = 0.1  # weight of a window in the running moments
_BEGIN, _END = 0.1, 0.4  # shares of fine-tuning between which limits widen
_MOST_RATIO, _MOST_SHIFT = 2.0, 5.0  # final limits of r - 1 (or 1 / r - 1) and of |d|


class Renormalisation:
    """Running moments of every layer of a decoder that is fine-tuned."""

    def __init__(self) -> None:
        self._running: dict[ConvolutionLayer, tuple[Tensor, Tensor]] = {}

    def decode(self, decoder: Decoder, field: RandomField, code: Tensor, share: float) -> Tensor:
        """Raw outputs as of Decoder.forward; `share` of fine-tuning is complete."""
        wide = min(1.0, max(0.0, (share - _BEGIN) / (_END - _BEGIN)))

        def adapt(layer: ConvolutionLayer, features: Tensor) -> Tensor:
            ratio, shift = self._correction(layer, features.detach().float(), wide)
            mean, deviation = (target.float() for target in layer.adain.target(code))
            scale, offset = deviation * ratio, mean + deviation * shift
            return F.batch_norm(features, None, None, scale, offset, True, 0.0, EPSILON)

        return decoder.run(field, adapt)

    def _correction(
        self, layer: ConvolutionLayer, features: Tensor, wide: float
    ) -> tuple[Tensor, Tensor]:
        """Ratio r and shift d of a layer, (C,) each, for its input (1, C, H, W)."""
        variance, own = torch.var_mean(features, (0, 2, 3), correction=0)
        square = variance + own.square()
        mean, mean_square = self._running.get(layer, (own, square))
        mean, mean_square = mean.lerp(own, _NEWEST), mean_square.lerp(square, _NEWEST)
        self._running[layer] = (mean, mean_square)
        deviation = ((mean_square - mean.square()).clamp_min(0.0) + EPSILON).sqrt()
        most = 1.0 + _MOST_RATIO * wide
        ratio = ((variance + EPSILON).sqrt() / deviation).clamp(1.0 / most, most)
        bound = _MOST_SHIFT * wide
        return ratio, ((own - mean) / deviation).clamp(-bound, bound)
