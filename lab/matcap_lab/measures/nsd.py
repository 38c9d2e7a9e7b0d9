"""Normalised style distance (NSD), by SqueezeNet 1.1 [iandola2016]; and VGG-16's Gram matrices.

The file holds the layers in order: each convolution is the tag below (4 bytes, little endian), its
weights as float16 (out, in, k, k) padded to 4 bytes, and its bias as float32 (out). The classifier
at its end is not read. `weights/README.md` says where the file comes from.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from matcap.errors import MatcapError
from matcap.files.tensors import StoredTensors
from matcap.statistics.compare import gram
from matcap_lab.measures.style import Group, Style, StyleStatistics, difference

WEIGHTS = Path(__file__).parent / "weights" / "squeezenet_v1.1.ncnn.bin"

_HALF_PRECISION = 0x01306B47
# (in, squeeze, expand) of the fire modules; each half of its output has `expand` channels.
_FIRES = (
    (64, 16, 64), (128, 16, 64), (128, 32, 128), (256, 32, 128),
    (256, 48, 192), (384, 48, 192), (384, 64, 256), (512, 64, 256),
)  # fmt: skip
_POOLED_BEFORE = (0, 2, 4)  # fire modules that a pooling stands before
_MEAN, _DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet, in code values


class Fire(nn.Module):
    """Channels squeezed by 1 x 1, then expanded by 1 x 1 and 3 x 3 side by side."""

    def __init__(self, channels: int, squeeze: int, expand: int) -> None:
        super().__init__()
        self.squeeze = nn.Conv2d(channels, squeeze, 1)
        self.expand1 = nn.Conv2d(squeeze, expand, 1)
        self.expand3 = nn.Conv2d(squeeze, expand, 3, padding=1)

    def forward(self, features: Tensor) -> Tensor:
        """(B, 2 expand, H, W) of (B, channels, H, W)."""
        squeezed = F.relu(self.squeeze(features))
        return F.relu(torch.cat([self.expand1(squeezed), self.expand3(squeezed)], dim=1))


class SqueezeNet(nn.Module):
    """The first convolution and the eight fire modules, without the classifier."""

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Conv2d(3, 64, 3, stride=2)
        self.fires = nn.ModuleList(Fire(*sizes) for sizes in _FIRES)
        self.requires_grad_(False)

    @staticmethod
    def load(path: Path = WEIGHTS) -> SqueezeNet:
        """With the weights of ncnn's file.

        Raises:
            MatcapError: there is no such file, or it holds something else.
        """
        try:
            data = path.read_bytes()
        except OSError as error:
            raise MatcapError(f"the weights cannot be read ({error})", where=str(path)) from error
        network = SqueezeNet()
        offset = 0
        for module in network.modules():
            if isinstance(module, nn.Conv2d):
                offset = _fill(module, data, offset, path)
        return network

    def forward(self, pictures: Tensor) -> list[Tensor]:
        """Nine rectified responses (B, C, h, w) of sRGB-encoded pictures (B, 3, H, W) in [0, 1]."""
        mean, deviation = (torch.tensor(v).to(pictures)[:, None, None] for v in (_MEAN, _DEVIATION))
        features = F.relu(self.first((pictures - mean) / deviation))
        activations = [features]
        for index, fire in enumerate(self.fires):
            if index in _POOLED_BEFORE:
                features = F.max_pool2d(features, 3, stride=2, ceil_mode=True)
            features = fire(features)
            activations.append(features)
        return activations


def _fill(convolution: nn.Conv2d, data: bytes, offset: int, path: Path) -> int:
    """Read a convolution's weights and bias at `offset`; gives the offset after them."""
    weight, bias = convolution.weight, convolution.bias
    assert bias is not None
    weights_at = offset + 4
    bias_at = weights_at + (2 * weight.numel() + 3) // 4 * 4
    end = bias_at + 4 * bias.numel()
    if end > len(data) or int.from_bytes(data[offset:weights_at], "little") != _HALF_PRECISION:
        raise MatcapError.at(
            path, "this is not SqueezeNet 1.1 in half precision", "see matcap_lab/measures"
        )
    read = np.frombuffer(data, "<f2", weight.numel(), weights_at).astype(np.float32)
    weight.copy_(torch.from_numpy(read).view_as(weight))
    bias.copy_(torch.from_numpy(np.frombuffer(data, "<f4", bias.numel(), bias_at).copy()))
    return end


# Gram matrices of VGG-16 [simonyan2015], which the paper measures style by.
#
# The user supplies the weights: a safetensors file with tensors conv1_1.weight to conv4_3.bias. The
# paper says "VGG" without network, layers or scale; here they are VGG-16's relu1_2, 2_2, 3_3 and
# 4_3, and the relative L1 difference of style.py.

_BLOCKS = ((3, 64, 2), (64, 128, 2), (128, 256, 3), (256, 512, 3))  # inputs, outputs, layers
_VGG_MEAN = (123.68, 116.779, 103.939)  # of 255 * sRGB
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
        features = 255.0 * pictures - torch.tensor(_VGG_MEAN)[:, None, None]
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


# Normalised style distance (NSD): style distance to the truth, over that of two true samples.
#
# The style distance by SqueezeNet, to which no setting is tuned, compares Gram matrices of its
# first convolution and its fire modules, at two scales. The distance of two Gram matrices is
# relative,
#
# |A - B|_1 / ((|A|_1 + |B|_1) / 2),
#
# and the measure is the mean over layers and scales: 0 for equal pictures, at most 2, and
# symmetric. It responds to open cells and broken threads, which linear filter banks hardly do.
#
# NSD divides it by the mean distance between true samples of the same material: 1 is
# indistinguishable from another sample. Larger pictures discriminate better: true samples of
# leather differ by 0.12 over the whole picture, by 0.19 over a quarter of it.

SCALES = 2  # the second of half the size
_SMALLEST = 64  # texels a side at the coarser scale


class SqueezeNetStyle:
    """Statistics of SqueezeNet's responses, a Style."""

    def __init__(self, network: SqueezeNet | None = None) -> None:
        """Take a network; by default SqueezeNet with the packaged weights."""
        self._network = network or SqueezeNet.load()

    @torch.no_grad()
    def __call__(self, pictures: Tensor) -> StyleStatistics:
        """Describe sRGB-encoded pictures (B, 3, H, W) in [0, 1], at least 128 texels a side.

        Raises:
            ValueError: smaller pictures.
        """
        if min(pictures.shape[-2:]) < _SMALLEST * 2 ** (SCALES - 1):
            raise ValueError(f"pictures of {tuple(pictures.shape)} are too small to be compared")
        groups = {}
        for scale in range(SCALES):
            responses = self._network(F.avg_pool2d(pictures, 2**scale))
            for layer, features in enumerate(responses):
                matrix = gram(features)[:, :-1, :-1]
                groups[f"scale {scale}, layer {layer}"] = Group(matrix.flatten(1), 0.0)
        return groups


def style_distance(style: Style, first: Tensor, second: Tensor) -> float:
    """Mean style distance of sRGB-encoded pictures (B, 3, H, W) in [0, 1], of the same lights."""
    return float(difference(style(first), style(second)).mean())


class StyleRatio:
    """Style distance to true samples of one material over that between them, by any one style.

    By SqueezeNet it is NSD.
    """

    def __init__(self, style: Style, truths: Sequence[Tensor]) -> None:
        """Describe true samples by a style.

        There are two or more of the material, none of them the photographed one, each (L, 3, H, W),
        relit from L directions.
        """
        self._style = style
        self._truths = [style(truth) for truth in truths]
        pairs = list(itertools.combinations(self._truths, 2))
        self.between_truths = sum(float(difference(a, b).mean()) for a, b in pairs) / len(pairs)

    def of(self, pictures: Tensor) -> float:
        """Ratio of pictures (L, 3, H, W) relit from the same directions; 1 is indistinguishable."""
        statistics = self._style(pictures)
        errors = [float(difference(statistics, truth).mean()) for truth in self._truths]
        return sum(errors) / len(errors) / self.between_truths
