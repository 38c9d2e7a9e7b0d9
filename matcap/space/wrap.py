"""Circular padding by one texel, for convolutions and upsampling on a torus.

Equal to torch.nn.functional.pad(mode="circular"), whose gradient copies the whole tensor once for
every side; this one does not.
"""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import Function, FunctionCtx, once_differentiable


def wrap(features: Tensor) -> Tensor:
    """(B, C, H + 2, W + 2) of (B, C, H, W), padded circularly."""
    # torch leaves apply untyped.
    return _Wrap.apply(features)  # type: ignore[no-untyped-call]


class _Wrap(Function):
    @staticmethod
    def forward(ctx: FunctionCtx, features: Tensor) -> Tensor:
        return F.pad(features, (1, 1, 1, 1), mode="circular")

    @staticmethod
    @once_differentiable
    def backward(ctx: FunctionCtx, gradient: Tensor) -> Tensor:
        """Add the gradient of each border texel to that of the texel it is a copy of."""
        rows = gradient[..., 1:-1, :].clone()
        rows[..., 0, :] += gradient[..., -1, :]
        rows[..., -1, :] += gradient[..., 0, :]
        texels = rows[..., 1:-1]
        texels[..., 0] += rows[..., -1]
        texels[..., -1] += rows[..., 0]
        return texels
