"""Optimiser of fine-tuning: Adam with clipped gradients, without the steps that are not finite."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.optim.adam import adam

from matcap.space.decoder import Decoder

_SMOOTHING = 0.05  # weight of the newest step in the running error
# Factor on the rate of the weights that read a drawing, which start at zero.
_DRAWING_RATE = 9.0
_LONGEST_GRADIENT = 1.0  # norm over all weights to which gradients are clipped


class Optimiser:
    """Takes steps of a decoder, and leaves out those whose loss or gradient is not finite.

    Attributes:
        error: running mean of the loss; NaN before the first step.
    """

    def __init__(self, decoder: Decoder, rate: float) -> None:
        self._decoder, self.error = decoder, math.nan
        self._rate, self._taken, self._adam = rate, 0, Adam(decoder)

    def take(self, loss: Tensor, penalty: Tensor, pace: float) -> bool:
        """Take a step; return whether it was taken.

        Args:
            loss: texture distance, whose running mean is the error.
            pace: share of the learning rate.
        """
        value = float(loss.detach())
        if not math.isfinite(value):
            return False
        self._decoder.zero_grad(set_to_none=True)
        (loss + penalty).backward()
        norm = torch.nn.utils.clip_grad_norm_(self._decoder.parameters(), _LONGEST_GRADIENT)
        if not math.isfinite(float(norm)):
            return False
        self._adam.step(self._rate * pace)
        self._taken += 1
        before = value if math.isnan(self.error) else self.error
        self.error = before + max(_SMOOTHING, 1.0 / self._taken) * (value - before)
        return True


class Adam:
    """Adam [kingma2015] by torch.optim's function; its class imports PyTorch's compiler (1 s)."""

    def __init__(self, decoder: Decoder) -> None:
        """Start with zero moments; steps change the decoder's weights in place."""
        self._parameters = [p for p in decoder.parameters() if p.requires_grad]
        self._drawing = decoder.drawing_weights()
        self._means = [torch.zeros_like(p) for p in self._parameters]
        self._squares = [torch.zeros_like(p) for p in self._parameters]
        self._steps = [torch.zeros(()) for _ in self._parameters]

    @torch.no_grad()
    def step(self, rate: float) -> None:
        """Take a step for all parameters that have a gradient; `rate` is the learning rate."""
        before = [weights.clone() for weights in self._drawing]
        had = [i for i, p in enumerate(self._parameters) if p.grad is not None]
        adam(
            [self._parameters[i] for i in had],
            [self._parameters[i].grad for i in had],  # type: ignore[misc]
            [self._means[i] for i in had],
            [self._squares[i] for i in had],
            [],
            [self._steps[i] for i in had],
            fused=True,
            amsgrad=False,
            beta1=0.9,
            beta2=0.99,
            lr=rate,
            weight_decay=0.0,
            eps=1e-8,
            maximize=False,
        )
        for weights, old in zip(self._drawing, before, strict=True):
            weights.copy_(old.lerp(weights, _DRAWING_RATE))
