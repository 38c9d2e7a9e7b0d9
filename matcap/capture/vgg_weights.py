"""Loading of VGG-19's weights from torchvision's file, which matcap does not distribute."""

from __future__ import annotations

import hashlib
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from matcap.errors import MatcapError
from matcap.statistics.vgg import Vgg19

# torchvision's address of the weights; the name contains the first digits of the file's SHA-256.
PUBLISHED = "https://download.pytorch.org/models/vgg19-dcbb9e9d.pth"
_DIGITS = "dcbb9e9d"
_REMEDY = f"download {PUBLISHED} and give its path"


def load_vgg19(path: Path) -> Vgg19:
    """Load VGG-19 from torchvision's .pth, or a .safetensors with the same tensor names.

    Raises:
        MatcapError: the file does not exist, has another hash, or tensors of other shapes.
    """
    network = Vgg19()
    weights = _read(path)
    wanted = network.state_dict()
    for name, value in wanted.items():
        if name not in weights or weights[name].shape != value.shape:
            raise MatcapError(
                f"this is not VGG-19: {name} is missing or of another shape",
                where=str(path),
                remedy=_REMEDY,
            )
    network.load_state_dict({name: weights[name].float() for name in wanted})
    return network


def _read(path: Path) -> dict[str, Tensor]:
    """Tensors by name; a .pth is accepted only with the published hash."""
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
