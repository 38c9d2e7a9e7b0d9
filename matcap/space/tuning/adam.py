"""Adam [kingma2015], without PyTorch's optimiser class."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.optim.adam import adam


class Adam:
    """Adam by torch.optim's function, as its class imports PyTorch's compiler, which takes 1 s."""

    def __init__(self, parameters: Sequence[Tensor]) -> None:
        """Start with zero moments; steps change the parameters, float tensors, in place."""
        self._parameters = list(parameters)
        self._means = [torch.zeros_like(p) for p in self._parameters]
        self._squares = [torch.zeros_like(p) for p in self._parameters]
        self._steps = [torch.zeros(()) for _ in self._parameters]

    @torch.no_grad()
    def step(self, rate: float) -> None:
        """Take a step for all parameters that have a gradient; `rate` is the learning rate."""
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
