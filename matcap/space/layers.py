"""Layers of the decoder: convolution on a torus in training, without padding in endless fields."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import Function, FunctionCtx, once_differentiable


def wrap(features: Tensor) -> Tensor:
    """(B, C, H + 2, W + 2) of (B, C, H, W), padded circularly by one texel.

    Equal to torch.nn.functional.pad(mode="circular"), whose gradient copies the whole tensor once
    for every side; this one does not.
    """
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


def convolve(
    parts: Sequence[Tensor], weights: Sequence[Tensor], bias: Tensor, *, activate: bool
) -> Tensor:
    """ReLU(bias + sum over i of parts[i] * weights[i]), * a convolution without padding.

    The frozen network's only costly operation. A convolution of concatenated features is the sum of
    the convolutions of its parts, so that nothing is concatenated. Where oneDNN supports it, bias,
    sum and ReLU are fused into the convolution.

    Args:
        parts: (B, C_i, H, W), in channels_last memory format.
        weights: (out, C_i, k, k), likewise.
        bias: (out,).

    Returns:
        (B, out, H - k + 1, W - k + 1), likewise.
    """
    if _fused(parts[0]):
        return _convolve_fused(parts, weights, bias, activate)
    total = F.conv2d(parts[0], weights[0], bias)
    for part, weight in zip(parts[1:], weights[1:], strict=True):
        total += F.conv2d(part, weight)
    return total.relu_() if activate else total


def _fused(features: Tensor) -> bool:
    if features.device.type != "cpu" or not torch.backends.mkldnn.is_available():
        return False
    if features.dtype == torch.bfloat16:
        return torch.ops.mkldnn._is_mkldnn_bf16_supported()
    return features.dtype == torch.float32


def _convolve_fused(
    parts: Sequence[Tensor], weights: Sequence[Tensor], bias: Tensor, activate: bool
) -> Tensor:
    shape = ([0, 0], [1, 1], [1, 1], 1)  # padding, stride, dilation, groups
    ends = [*["none"] * (len(parts) - 1), "relu" if activate else "none"]
    total = torch.ops.mkldnn._convolution_pointwise(
        parts[0], weights[0], bias, *shape, ends[0], [], ""
    )
    for part, weight, end in zip(parts[1:], weights[1:], ends[1:], strict=True):
        unary = end if end == "relu" else None
        total = torch.ops.mkldnn._convolution_pointwise_(
            total, part, weight, None, *shape, "add", 1.0, unary, [], None
        )
    return total
