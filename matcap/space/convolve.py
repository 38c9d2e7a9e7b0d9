"""The steps of the frozen network, above all: convolutions without padding, a bias, a ReLU.

A convolution of features laid side by side is the sum of the convolutions of its parts: nothing
is copied together. On processors that oneDNN knows, bias, sum and ReLU happen as the convolution
writes its result; elsewhere in separate steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
import torch.nn.functional as F
from torch import Tensor


class Convolve(Protocol):
    """See `convolve`."""

    def __call__(
        self, parts: Sequence[Tensor], weights: Sequence[Tensor], bias: Tensor, *, activate: bool
    ) -> Tensor:
        """ReLU(bias + sum of parts[i] * weights[i]); only where the kernel lies inside."""
        ...


@dataclass(frozen=True)
class Steps:
    """What a network is computed by: operations that agree on how features lie in memory."""

    convolve: Convolve
    """As `convolve`."""
    halve: Callable[[Tensor], Tensor]
    """(B, C, H, W) to (B, C, H / 2, W / 2), the largest of every four."""
    lay: Callable[[Tensor], Tensor]
    """A part of features as the others want it."""


def convolve(
    parts: Sequence[Tensor], weights: Sequence[Tensor], bias: Tensor, *, activate: bool
) -> Tensor:
    """ReLU(bias + sum of parts[i] * weights[i]); only where the kernel lies inside.

    Args:
        parts: (B, C_i, H, W), channels last in memory.
        weights: (out, C_i, k, k), channels last in memory.
        bias: (out,).
        activate: apply the ReLU.

    Returns:
        (B, out, H - k + 1, W - k + 1), channels last in memory.
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
    last = "relu" if activate else "none"
    ends = [*["none"] * (len(parts) - 1), last]
    total = torch.ops.mkldnn._convolution_pointwise(
        parts[0], weights[0], bias, *shape, ends[0], [], ""
    )
    for part, weight, end in zip(parts[1:], weights[1:], ends[1:], strict=True):
        unary = end if end == "relu" else None
        total = torch.ops.mkldnn._convolution_pointwise_(
            total, part, weight, None, *shape, "add", 1.0, unary, [], None
        )
    return total


def _halve(features: Tensor) -> Tensor:
    return F.max_pool2d(features, 2)


def _lay(features: Tensor) -> Tensor:
    return features.contiguous(memory_format=torch.channels_last)


CHANNELS_LAST = Steps(convolve, _halve, _lay)
