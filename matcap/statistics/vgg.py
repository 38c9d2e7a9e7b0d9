"""VGG-19's features, as the paper compares textures by (Simonyan and Zisserman 2015).

The first convolution of each of five blocks (Gatys et al. 2015), rectified, of the picture as a
display shows it. The network is defined here, under torchvision's names of its parameters; its
weights are not matcap's to give: `Vgg19.load` reads torchvision's file. Never needed otherwise.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from matcap.errors import MatcapError
from matcap.files.srgb import srgb_encode_tensor

# Channels of the convolutions, "M" a max-pooling (configuration E), up to the last one looked at.
_LAYERS: tuple[int | str, ...] = (
    64, 64, "M", 128, 128, "M", 256, 256, 256, 256, "M", 512, 512, 512, 512, "M", 512,
)  # fmt: skip
_LOOKED_AT = (0, 2, 4, 8, 12)  # of the convolutions: the first of each block
_MEAN, _DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet, in code values
# Where torchvision publishes the weights: the name holds the first digits of the file's SHA-256.
PUBLISHED = "https://download.pytorch.org/models/vgg19-dcbb9e9d.pth"
_DIGITS = "dcbb9e9d"
_REMEDY = f"download {PUBLISHED} and give its path"


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

    @staticmethod
    def load(path: Path) -> Vgg19:
        """With torchvision's weights, a .pth as published or a .safetensors of the same names.

        Raises:
            MatcapError: no such file, not what torchvision publishes, or other shapes.
        """
        network = Vgg19()
        found = _read(path)
        wanted = network.state_dict()
        for name, value in wanted.items():
            if name not in found or found[name].shape != value.shape:
                raise MatcapError(
                    f"this is not VGG-19: {name} is missing or of another shape",
                    where=str(path),
                    remedy=_REMEDY,
                )
        network.load_state_dict({name: found[name].float() for name in wanted})
        return network

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
        found, convolution = [], -1
        for layer in self.features:
            features = layer(features)
            if isinstance(layer, nn.Conv2d):
                convolution += 1
            elif isinstance(layer, nn.ReLU) and convolution in _LOOKED_AT:
                found.append(features)
        return found


def _read(path: Path) -> dict[str, Tensor]:
    if not path.is_file():
        raise MatcapError("there are no such weights", where=str(path), remedy=_REMEDY)
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        with path.open("rb") as file:
            digits = hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, SafetensorError) as error:
        raise MatcapError(
            f"the weights cannot be read ({error})", where=str(path), remedy=_REMEDY
        ) from error
    if not digits.startswith(_DIGITS):
        raise MatcapError(
            f"this is not the published file: its SHA-256 begins with {digits[:8]}, not {_DIGITS}",
            where=str(path),
            remedy=_REMEDY,
        )
    # Tensors alone: nothing in the file is executed.
    weights: dict[str, Tensor] = torch.load(path, map_location="cpu", weights_only=True)
    return weights
