"""Gram matrices of features (Gatys et al. 2015; paper, equation 3)."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd.function import BackwardCFunction, FunctionCtx, once_differentiable


def gram(features: Tensor) -> Tensor:
    """(B, C + 1, C + 1) second moments of features (B, C, H, W) and the constant 1, float32.

    Averaged over the texels; the last column therefore holds the features' means.
    """
    rows = features.permute(0, 2, 3, 1).flatten(1, 2)  # no copy where channels are last in memory
    # torch leaves apply untyped.
    second: Tensor = _SecondMoments.apply(rows)  # type: ignore[no-untyped-call]
    first = rows.mean(dim=1, dtype=torch.float32)
    one = torch.ones_like(first[:, :1])
    top = torch.cat([second, first[:, :, None]], dim=2)
    return torch.cat([top, torch.cat([first, one], dim=1)[:, None]], dim=1)


class _SecondMoments(torch.autograd.Function):
    """X'X / n of (B, n, C), float32; differentiated as the symmetric product it is, in one go."""

    @staticmethod
    def forward(ctx: FunctionCtx, rows: Tensor) -> Tensor:
        ctx.save_for_backward(rows)
        return (torch.bmm(rows.transpose(1, 2), rows) / rows.shape[1]).float()

    @staticmethod
    @once_differentiable
    def backward(ctx: BackwardCFunction, gradient: Tensor) -> Tensor:
        (rows,) = ctx.saved_tensors
        symmetric = (gradient + gradient.transpose(1, 2)) / rows.shape[1]
        return torch.bmm(rows, symmetric.to(rows))
