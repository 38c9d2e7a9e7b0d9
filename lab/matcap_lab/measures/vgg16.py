"""Gram matrices of VGG-16 [simonyan2015], which the paper measures style by.

The user supplies the weights: a safetensors file with tensors conv1_1.weight to conv4_3.bias. The
paper says "VGG" without network, layers or scale; here they are VGG-16's relu1_2, 2_2, 3_3 and
4_3, and the relative L1 difference of style.py.
"""

from __future__ import annotations

from pathlib import Path

import torch
import torch.nn.functional as F
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from matcap.errors import MatcapError
from matcap.files.tensors import StoredTensors
from matcap.statistics.gram import gram
from matcap_lab.measures.style import Group, StyleStatistics

_BLOCKS = ((3, 64, 2), (64, 128, 2), (128, 256, 3), (256, 512, 3))  # inputs, outputs, layers
_MEAN = (123.68, 116.779, 103.939)  # of 255 * sRGB
_REMEDY = "give a safetensors file of VGG-16 with tensors conv1_1.weight to conv4_3.bias"


class Vgg16Style:
    """Gram matrices of the last layer of VGG-16's first four blocks, a Style."""

    def __init__(self, path: Path) -> None:
        """Read the weights.

        Raises:
            MatcapError: missing, or a tensor is missing or of another shape.
        """
        layers = {
            f"conv{block}_{n}": nn.Conv2d(
                outputs if n > 1 else inputs, outputs, 3, padding=1, device="meta"
            )
            for block, (inputs, outputs, count) in enumerate(_BLOCKS, 1)
            for n in range(1, count + 1)
        }
        try:
            with safe_open(path, framework="pt") as file:
                self._layers = StoredTensors(file, path, _REMEDY).load(nn.ModuleDict(layers))
        except (SafetensorError, OSError) as error:
            raise MatcapError.at(
                path, f"the weights of VGG-16 cannot be read ({error})", _REMEDY
            ) from error

    def features(self, pictures: Tensor) -> list[Tensor]:
        """Responses (B, C, h, w) of each block to sRGB pictures (B, 3, H, W) in [0, 1]."""
        features = 255.0 * pictures - torch.tensor(_MEAN)[:, None, None]
        activations = []
        for block, (_, _, count) in enumerate(_BLOCKS, 1):
            if block > 1:
                features = F.max_pool2d(features, 2)
            for n in range(1, count + 1):
                features = F.relu(self._layers[f"conv{block}_{n}"](features))
            activations.append(features)
        return activations

    @torch.no_grad()
    def __call__(self, pictures: Tensor) -> StyleStatistics:
        """Gram matrices of each block, of sRGB pictures (B, 3, H, W) in [0, 1]."""
        return {
            f"block {number}": Group(gram(features)[:, :-1, :-1].flatten(1), 0.0)
            for number, features in enumerate(self.features(pictures), 1)
        }
