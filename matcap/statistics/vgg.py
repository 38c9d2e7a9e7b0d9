"""VGG-19's features, as the paper compares textures by [simonyan2015].

The first convolution of each of five blocks [gatys2015], rectified, of the picture as a
display shows it. The network is defined here, under torchvision's names of its parameters; its
weights are not matcap's to give (capture/vgg_weights.py reads them). Never needed otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from matcap.files.srgb import srgb_encode_tensor

# Channels of the convolutions, "M" a max-pooling (configuration E), up to the last one looked at.
_LAYERS: tuple[int | str, ...] = (
    64, 64, "M", 128, 128, "M", 256, 256, 256, 256, "M", 512, 512, 512, 512, "M", 512,
)  # fmt: skip
_LOOKED_AT = (0, 2, 4, 8, 12)  # of the convolutions: the first of each block
_MEAN, _DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet, in code values


class Vgg19(nn.Module):
    """Features for describe(), in place of a filter bank.

    Attributes:
        levels: of the pyramid of the colours, whose spectra and distributions go with the features.
        crossed: False, as in the paper: deep features see several scales at once.
    """

    crossed = False

    def __init__(self, levels: int = 4) -> None:
        super().__init__()
        self.levels = levels
        layers: list[nn.Module] = []
        channels = 3
        for layer in _LAYERS:
            if isinstance(layer, str):
                layers.append(nn.MaxPool2d(2))
                continue
            layers += [nn.Conv2d(channels, layer, 3, padding=1), nn.ReLU()]
            channels = layer
        self.features = nn.Sequential(*layers)
        self.requires_grad_(False)

    def maps(self, linear: Tensor, colours: Sequence[Tensor]) -> list[Tensor]:
        """Five rectified responses, (B, C, H / 2^k, W / 2^k), of radiance (B, 3, H, W).

        Borders are padded with zeros, which colours the outermost few texels of every layer.
        """
        del colours  # the network halves on its own
        mean, deviation = (
            torch.tensor(v, dtype=linear.dtype)[:, None, None] for v in (_MEAN, _DEVIATION)
        )
        features = ((srgb_encode_tensor(linear.clamp(0.0, 1.0)) - mean) / deviation).contiguous(
            memory_format=torch.channels_last
        )
        activations, convolution = [], -1
        for layer in self.features:
            features = layer(features)
            if isinstance(layer, nn.Conv2d):
                convolution += 1
            elif isinstance(layer, nn.ReLU) and convolution in _LOOKED_AT:
                activations.append(features)
        return activations
