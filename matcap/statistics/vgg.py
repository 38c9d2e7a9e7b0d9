"""VGG-19 features [simonyan2015], by which the paper compares textures [henzler2021].

The rectified first convolution of each of five blocks [gatys2015], of the sRGB-encoded image. The
parameters have torchvision's names. The weights are not distributed with matcap; an optional file
of the user's is read by capture/vgg_weights.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from matcap.files.srgb import srgb_encode_tensor

# Output channels of the convolutions, "M" for max-pooling (configuration E), up to the last used.
_LAYERS: tuple[int | str, ...] = (
    64, 64, "M", 128, 128, "M", 256, 256, 256, 256, "M", 512, 512, 512, 512, "M", 512,
)  # fmt: skip
_USED = (0, 2, 4, 8, 12)  # indices of convolutions: the first of each block
_MEAN, _DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet, in code values


class Vgg19(nn.Module):
    """VGG-19 features; implements compare.Features in place of a FilterBank.

    Attributes:
        levels: of the colour pyramid, whose spectra and quantiles are in the descriptor, too.
        crossed: False, as in the paper: deep features span several scales.
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

        Zero padding affects the outermost few texels of every layer.
        """
        del colours  # the network has its own pyramid
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
            elif isinstance(layer, nn.ReLU) and convolution in _USED:
                activations.append(features)
        return activations
