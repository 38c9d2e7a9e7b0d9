"""Rollback on divergence: undoes steps that diverge, and keeps the best decoder."""

from __future__ import annotations

import copy
import math

import torch
from torch import Tensor
from torch.optim.adam import adam

from matcap.space.decoder import Decoder

# Rollback; docs/notes/prior.md.
_SMOOTHING = 0.05  # weight of the newest step in the running error
_EXPLODED = 4.0  # loss over running error beyond which a step diverges
_LEAST_ERROR = 0.1  # lower limit of the running error in that ratio
_SNAPSHOT_EVERY = 20  # steps between comparisons with the best decoder
# Factor on the rate of the weights that read a drawing, which start at zero.
_DRAWING_RATE = 9.0
_LONGEST_GRADIENT = 1.0  # norm over all weights to which gradients are clipped


class Rollback:
    """Optimiser with rollback.

    A step diverges if its loss or gradient is not finite, or its loss exceeds _EXPLODED
    times the running error. Then the best decoder is restored and the learning rate halved.

    Attributes:
        decoder: changed by every step.
        error: running mean of the loss; NaN before the first step.
    """

    def __init__(self, decoder: Decoder, rate: float) -> None:
        self.decoder, self.error = decoder, math.nan
        self._rate, self._step = rate, 0
        self._optimiser = Adam(decoder)
        self.begin_again()

    def begin_again(self) -> None:
        """Make the present decoder the best one, whatever its error."""
        self._best, self._best_error = copy.deepcopy(self.decoder.state_dict()), math.inf

    def take(self, loss: Tensor, penalty: Tensor, pace: float) -> bool:
        """Take a step, or roll back; return whether the step was taken.

        Args:
            loss: texture distance, whose running mean is the error.
            pace: share of the learning rate.
        """
        self._step += 1
        value = float(loss.detach())
        slope = math.nan
        limit = _EXPLODED * max(self.error, _LEAST_ERROR)
        if math.isfinite(value) and not value > limit:
            self.decoder.zero_grad(set_to_none=True)
            (loss + penalty).backward()
            parameters = self.decoder.parameters()
            slope = float(torch.nn.utils.clip_grad_norm_(parameters, _LONGEST_GRADIENT))
        if not math.isfinite(slope):
            self.decoder.load_state_dict(self._best)
            self.error = self._best_error if math.isfinite(self._best_error) else math.nan
            self._rate *= 0.5
            self._optimiser = Adam(self.decoder)
            return False
        self._optimiser.step(self._rate * pace)
        smoothing = max(_SMOOTHING, 1.0 / self._step)
        before = value if math.isnan(self.error) else self.error
        self.error = before + smoothing * (value - before)
        if self._step % _SNAPSHOT_EVERY == 0 and self.error < self._best_error:
            self._best = copy.deepcopy(self.decoder.state_dict())
            self._best_error = self.error
        return True

    def finish(self) -> None:
        """Restore the best decoder."""
        if self._best_error < self.error:
            self.decoder.load_state_dict(self._best)


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
