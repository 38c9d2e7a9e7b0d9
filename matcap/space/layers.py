"""Layers: residual blocks, convolution on a torus, and convolution without padding."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.autograd.function import Function, FunctionCtx, once_differentiable

# Residual blocks [he2016] are those of encoder and alignment branch. The decoder is trained on a
# torus, padded circularly, and frozen for endless fields, where nothing is padded.


_GROUP = 16  # channels normalised together


class Shortcut(nn.Module):
    """Layers with a shortcut: identity, or a 1 x 1 convolution where the shape changes."""

    def __init__(self, layers: Sequence[nn.Module], inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.body = nn.Sequential(*layers)
        self.shortcut: nn.Module = nn.Identity()
        if inputs != outputs or stride != 1:
            self.shortcut = nn.Sequential(*convolution(inputs, outputs, 1, stride))

    def forward(self, features: Tensor) -> Tensor:
        """(B, inputs, h, w) to (B, outputs, h / stride, w / stride)."""
        return F.relu(self.body(features) + self.shortcut(features))


def residual_block(inputs: int, outputs: int, stride: int) -> Shortcut:
    """Two 3 x 3 convolutions with a shortcut."""
    layers = [
        *convolution(inputs, outputs, 3, stride),
        nn.ReLU(inplace=True),
        *convolution(outputs, outputs, 3),
    ]
    return Shortcut(layers, inputs, outputs, stride)


def convolution(inputs: int, outputs: int, side: int, stride: int = 1) -> list[nn.Module]:
    """A convolution with group normalisation."""
    return [
        nn.Conv2d(inputs, outputs, side, stride, side // 2, bias=False),
        nn.GroupNorm(outputs // _GROUP, outputs),
    ]


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
