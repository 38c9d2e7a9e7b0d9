"""Rollback on divergence: bad steps of fine-tuning are undone, and the best decoder is kept."""

from __future__ import annotations

import copy
import math

import torch
from torch import Tensor

from matcap.flash.adam import Adam
from matcap.space.decoder import Decoder
from matcap.space.tuning.tuned import GUARD


class Rollback:
    """Moves a decoder along the gradient of a loss, and back where that goes wrong.

    A step goes wrong whose loss or gradient is not finite, or whose loss explodes. The decoder is
    the best one again then, and the rate half as large.

    Attributes:
        decoder: changed by every step.
        error: running mean of the loss, or NaN before the first good step.
    """

    def __init__(self, decoder: Decoder, rate: float) -> None:
        self.decoder, self.error = decoder, math.nan
        self._rate, self._step = rate, 0
        self._optimiser = _adam(decoder)
        self.begin_again()

    def begin_again(self) -> None:
        """What counts as best so far is the decoder as it is: what went before is another run."""
        self._best, self._best_error = copy.deepcopy(self.decoder.state_dict()), math.inf

    def take(self, loss: Tensor, penalty: Tensor, pace: float) -> bool:
        """Take a step at a share of the learning rate; whether it went well.

        Args:
            loss: whose running mean is the error.
            penalty: what is added to it.
            pace: share of the learning rate.
        """
        self._step += 1
        value = float(loss.detach())
        slope = math.nan
        if math.isfinite(value) and not value > GUARD.exploded * max(self.error, GUARD.least_error):
            self.decoder.zero_grad(set_to_none=True)
            (loss + penalty).backward()
            parameters = self.decoder.parameters()
            slope = float(torch.nn.utils.clip_grad_norm_(parameters, GUARD.longest_gradient))
        if not math.isfinite(slope):
            self._back()
            return False
        self._optimiser.step(self._rate * pace)
        smoothing = max(GUARD.smoothing, 1.0 / self._step)
        before = value if math.isnan(self.error) else self.error
        self.error = before + smoothing * (value - before)
        if self._step % GUARD.snapshot_every == 0 and self.error < self._best_error:
            self._best = copy.deepcopy(self.decoder.state_dict())
            self._best_error = self.error
        return True

    def finish(self) -> None:
        """Leave the decoder as the best one."""
        if self._best_error < self.error:
            self.decoder.load_state_dict(self._best)

    def _back(self) -> None:
        self.decoder.load_state_dict(self._best)
        self.error = self._best_error if math.isfinite(self._best_error) else math.nan
        self._rate *= 0.5
        self._optimiser = _adam(self.decoder)


def _adam(decoder: Decoder) -> Adam:
    return Adam([p for p in decoder.parameters() if p.requires_grad])
