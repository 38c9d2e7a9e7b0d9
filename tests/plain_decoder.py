"""A folded decoder over a whole field at once, to which its decoding by blocks is held."""

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.space.decoder import ascend, descend
from matcap.space.freeze import FoldedDecoder, FoldedLayer
from matcap.space.random_field import RandomField


def _padded(layer: FoldedLayer):
    def step(features: Tensor) -> Tensor:
        weight = torch.cat(layer.weights, dim=1)
        features = F.conv2d(features, weight, layer.bias, padding=weight.shape[-1] // 2)
        return features.relu_() if layer.activate else features

    return step


def decoded(decoder: FoldedDecoder, field: RandomField) -> Tensor:
    """Raw outputs of a field; borders are padded with zeros, and so a halo is not valid."""
    down, up = (
        [[_padded(one) for one in block] for block in side] for side in (decoder.down, decoder.up)
    )
    kinds = [each for each in (field.drawing, field.waves if decoder.has_waves else ()) if each]
    read = [torch.cat(level, 1) for level in zip(*kinds, strict=True)]
    return ascend(descend(field.noise, down), read, up, _padded(decoder.head), periodic=False)
