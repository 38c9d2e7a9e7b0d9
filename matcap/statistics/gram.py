"""Gram matrices of features [gatys2015] [henzler2021, eq. 3], and covariances between levels.

One autograd function computes the gradients of all levels, as matrix products added in place; that
takes half the time of one function per level.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import BackwardCFunction, FunctionCtx, once_differentiable

Matrices = tuple[Tensor, ...]
_Part = tuple[slice, slice]  # rows and columns


def gram(features: Tensor) -> Tensor:
    """(B, C + 1, C + 1) second moments of features (B, C, H, W) and the constant 1, float32.

    Averaged over the texels; the last column therefore holds the features' means.
    """
    return moments([features], crossed=False)[0][0]


def moments(features: Sequence[Tensor], *, crossed: bool) -> tuple[Matrices, Matrices]:
    """Gram matrices of feature maps, and covariances of successive ones.

    Args:
        features: (B, C, H, W) each; fastest in channels_last memory format.
        crossed: compute covariances; each map must have half the resolution of the one before.

    Returns:
        gram() of each map; and, if crossed, for each but the last, the (B, C, D) covariances of its
        features, averaged over 2 x 2 texels, with those of the next map, float32. Maps of one image
        are aligned at their centres; the covariance is over the rectangle that both cover.
    """
    # torch leaves apply untyped.
    matrices: Matrices = _Moments.apply(crossed, *features)  # type: ignore[no-untyped-call]
    return matrices[: len(features)], matrices[len(features) :]


class _Moments(torch.autograd.Function):
    """X^T X / n of texels as rows X (B, n, C), and (X - mean X)^T Y / n of successive maps."""

    @staticmethod
    def forward(ctx: FunctionCtx, crossed: bool, *features: Tensor) -> Matrices:
        centred, crosses = [], []
        for fine, coarse in zip(features, features[1:], strict=False) if crossed else ():
            halved = F.avg_pool2d(fine, 2)
            (y, x), there = _middles(halved, coarse)
            one = _rows(halved[..., y, x])
            # One mean is enough: the covariance with a constant is 0.
            one = one - one.mean(dim=1, keepdim=True)
            other = _rows(coarse[..., there[0], there[1]])
            centred.append(one)
            crosses.append((torch.bmm(one.transpose(1, 2), other) / one.shape[1]).float())
        ctx.save_for_backward(*features, *centred)
        ctx.count = len(features)  # type: ignore[attr-defined]
        return (*map(_gram, features), *crosses)

    @staticmethod
    @once_differentiable
    def backward(ctx: BackwardCFunction, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        count = ctx.count  # type: ignore[attr-defined]
        features, centred = ctx.saved_tensors[:count], ctx.saved_tensors[count:]
        back = [_gram_back(*pair) for pair in zip(features, gradients, strict=False)]
        for level, (one, gradient) in enumerate(zip(centred, gradients[count:], strict=True)):
            slope = (gradient / one.shape[1]).to(one)
            coarse, fours = features[level + 1], _fours(back[level])
            (y, x), (v, u) = _middles(fours[..., 0, :, 0], coarse)
            other = _rows(coarse[..., v, u])
            other = other - other.mean(dim=1, keepdim=True)
            met = back[level + 1][..., v, u]
            met += _planes(torch.bmm(one, slope), met)
            one_of_four = 0.25 * slope.transpose(1, 2)
            fours[..., y, :, x, :] += _planes(torch.bmm(other, one_of_four), met)[
                ..., None, :, None
            ]
        return None, *back


def _gram(features: Tensor) -> Tensor:
    rows = _rows(features)
    second = (torch.bmm(rows.transpose(1, 2), rows) / rows.shape[1]).float()
    first = rows.mean(dim=1, dtype=torch.float32)
    one = torch.ones_like(first[:, :1])
    top = torch.cat([second, first[:, :, None]], dim=2)
    return torch.cat([top, torch.cat([first, one], dim=1)[:, None]], dim=1)


def _gram_back(features: Tensor, gradient: Tensor) -> Tensor:
    """Gradient by the features from the gradient by their gram(), which is symmetric in them."""
    rows = _rows(features)
    symmetric = ((gradient + gradient.transpose(1, 2)) / rows.shape[1]).to(rows)
    slopes = torch.baddbmm(symmetric[:, -1:, :-1], rows, symmetric[:, :-1, :-1])
    return _planes(slopes, features)


def _middles(halved: Tensor, coarse: Tensor) -> tuple[_Part, _Part]:
    """Rows and columns of the largest common rectangle, for planes aligned at their centres."""
    (y, v), (x, u) = (_middle(halved.shape[axis], coarse.shape[axis]) for axis in (2, 3))
    return (y, x), (v, u)


def _middle(one: int, other: int) -> tuple[slice, slice]:
    """Central slices of two axes, both as long as the shorter axis."""
    side = min(one, other)
    first, second = (one - side) // 2, (other - side) // 2
    return slice(first, first + side), slice(second, second + side)


def _rows(features: Tensor) -> Tensor:
    """(B, H W, C) of (B, C, H, W); a view in channels_last memory format."""
    return features.permute(0, 2, 3, 1).flatten(1, 2)


def _planes(rows: Tensor, like: Tensor) -> Tensor:
    """Inverse of _rows: (B, C, H, W) of (B, H W, C)."""
    return rows.unflatten(1, like.shape[-2:]).permute(0, 3, 1, 2)


def _fours(planes: Tensor) -> Tensor:
    """View (B, C, H / 2, 2, W / 2, 2) of (B, C, H, W): 2 x 2 texels per texel of half the size."""
    height, width = (side // 2 for side in planes.shape[-2:])
    even = planes[..., : 2 * height, : 2 * width]
    return even.unflatten(-2, (height, 2)).unflatten(-1, (width, 2))
