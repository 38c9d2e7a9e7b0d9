"""Gram matrices of features (Gatys et al. 2015; paper, equation 3), and across two levels."""

from __future__ import annotations

import torch
import torch.nn.functional as F
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


def covariance(fine: Tensor, coarse: Tensor) -> Tensor:
    """(B, C, D) covariances of features (B, C, H, W) with (B, D, h, w) half as fine, float32.

    Averaged over where both are known: they are maps of one picture, so their middles meet.
    """
    # torch leaves apply untyped.
    halved: Tensor = _Halved.apply(fine)  # type: ignore[no-untyped-call]
    height, width = (min(a, b) for a, b in zip(halved.shape[-2:], coarse.shape[-2:], strict=True))

    def rows(features: Tensor) -> Tensor:
        y, x = (features.shape[-2] - height) // 2, (features.shape[-1] - width) // 2
        return features[..., y : y + height, x : x + width].permute(0, 2, 3, 1).flatten(1, 2)

    one = rows(halved)
    # One mean is enough: the covariance with a constant is 0.
    one = one - one.mean(dim=1, keepdim=True)
    return torch.bmm(one.transpose(1, 2), rows(coarse)).float() / (height * width)


class _Halved(torch.autograd.Function):
    """Means of 2 x 2; avg_pool2d, whose own gradient takes three times as long to go back."""

    @staticmethod
    def forward(ctx: FunctionCtx, features: Tensor) -> Tensor:
        ctx.shape = features.shape  # type: ignore[attr-defined]
        return F.avg_pool2d(features, 2)

    @staticmethod
    @once_differentiable
    def backward(ctx: BackwardCFunction, gradient: Tensor) -> Tensor:
        height, width = ctx.shape[-2:]  # type: ignore[attr-defined]
        last = (gradient / 4.0).permute(0, 2, 3, 1)  # as channels lie in memory
        wide = last[:, :, None, :, None].expand(-1, -1, 2, -1, 2, -1).flatten(3, 4).flatten(1, 2)
        back = wide.permute(0, 3, 1, 2)
        missing = (0, width - back.shape[-1], 0, height - back.shape[-2])
        return F.pad(back, missing) if any(missing) else back


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
