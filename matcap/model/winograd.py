"""The steps of wide networks: Winograd's convolutions, channels first.

To compute 6 x 6 outputs of a 3 x 3 convolution at once takes 64 multiplications instead of 324
(Lavin and Gray 2016, "Fast Algorithms for Convolutional Neural Networks"). NNPACK, which comes
with PyTorch, does it so. Moving to and fro between the two forms costs per channel what the
multiplications cost per pair of channels: it pays for 32 channels and more, and only where the
whole network is so wide, because oneDNN's channels would have to be moved from last to first.

In float32 all the same, but rounding ten times as coarse as the plain sum's
(docs/notes/synthesis.md).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.model.convolve import Steps

_WIDE = 32  # channels from which on it is faster


def available() -> bool:
    """Whether NNPACK is there and knows this processor."""
    return torch.backends.nnpack.is_available()


def is_wide(weights: Sequence[Tensor]) -> bool:
    """Whether a convolution of these parts gains: 3 x 3, in float32, from and to many channels."""
    outputs, _, _, kernel = weights[0].shape
    inputs = sum(weight.shape[1] for weight in weights)
    narrowest = min(inputs, outputs)
    one = weights[0]
    return (
        kernel == 3
        and narrowest >= _WIDE
        and one.dtype == torch.float32
        and one.device.type == "cpu"
    )


def _convolve(
    parts: Sequence[Tensor], weights: Sequence[Tensor], bias: Tensor, *, activate: bool
) -> Tensor:
    """As convolve.convolve, but for channels first."""
    # Parts are laid side by side: summed up, each of them would be transformed back on its own.
    features, weight = _joined(parts), _joined(weights)
    if is_wide(weights):
        total = torch._nnpack_spatial_convolution(features, weight, bias, 0)
    else:
        total = F.conv2d(features, weight, bias)
    return total.relu_() if activate else total


def _joined(parts: Sequence[Tensor]) -> Tensor:
    """Side by side along the channels, which come first."""
    return (parts[0] if len(parts) == 1 else torch.cat(list(parts), 1)).contiguous()


def _halve(features: Tensor) -> Tensor:
    """F.max_pool2d, which takes nine times as long with channels first."""
    rows = torch.maximum(features[..., ::2, :], features[..., 1::2, :])
    return torch.maximum(rows[..., ::2], rows[..., 1::2])


def _lay(features: Tensor) -> Tensor:
    """As they are: the next step copies them anyway."""
    return features


WINOGRAD = Steps(_convolve, _halve, _lay)
