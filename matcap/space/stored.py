"""Reading a network from a safetensors file that a stranger may have written.

Nothing in such a file is executed. Its description states a shape; the shape is bounded, and every
tensor is compared with it before it is read.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from matcap.errors import MatcapError
from matcap.space.decoder import DEPTH, Decoder, DecoderConfig
from matcap.space.grains import GRAIN_CHANNELS

_LARGEST_WIDTH = 1024  # channels; a stranger's file cannot ask for more memory than this allows
_MOST_CELLS = 64  # channels at full resolution, whatever the network makes of them
_MOST_NUMBERS = 64_000_000  # weights; a quarter of a gigabyte


@dataclass(frozen=True)
class StoredTensors:
    """An open file.

    Attributes:
        file: as safetensors opens it, for PyTorch.
        path: where it is.
        remedy: what to do when it is no good.
    """

    file: safe_open
    path: Path
    remedy: str

    def tensor(self, name: str, shape: tuple[int, ...]) -> Tensor:
        """One tensor as float32.

        Raises:
            MatcapError: it is missing, of another shape, or holds NaN or infinity; names it.
        """
        try:
            found = tuple(self.file.get_slice(name).get_shape())
        except SafetensorError as error:
            raise self._fault(f"the tensor {name} is missing") from error
        if found != shape:
            raise self._fault(f"the tensor {name} has shape {found}, expected {shape}")
        # A copy, because the file's own lie wherever the file has them, and products of matrices
        # round as their operands are aligned: what was saved would differ from itself by a bit.
        value: Tensor = self.file.get_tensor(name).to(torch.float32, copy=True)
        if not bool(torch.isfinite(value).all()):
            raise self._fault(f"the tensor {name} holds NaN or infinity")
        return value

    def _fault(self, what: str) -> MatcapError:
        return MatcapError(what, where=str(self.path), remedy=self.remedy)


def decoder_config(stated: Mapping[str, Any]) -> DecoderConfig:
    """The shape of a decoder as a description states it.

    Raises:
        ValueError, KeyError, IndexError, TypeError: it states none, or none that could be.
    """
    config = DecoderConfig(
        noise_channels=int(stated["noise_channels"]),
        widths=tuple(int(width) for width in stated["widths"]),
        convolutions=(int(stated["convolutions"][0]), int(stated["convolutions"][1])),
        cells=int(stated["cells"]),
        grains=int(stated.get("grains", 0)),  # the prior that comes with matcap states none
    )
    sizes = (config.noise_channels, *config.widths)
    if len(config.widths) != DEPTH + 1 or not all(1 <= s <= _LARGEST_WIDTH for s in sizes):
        raise ValueError(f"widths {config.widths} are not {DEPTH + 1} of at most {_LARGEST_WIDTH}")
    if not 0 <= config.cells <= _MOST_CELLS:
        raise ValueError(f"{config.cells} channels of cells")
    if not 0 <= config.grains <= GRAIN_CHANNELS:
        raise ValueError(f"{config.grains} channels of structured noise")
    if not all(1 <= count <= 4 for count in config.convolutions):
        raise ValueError(f"{config.convolutions} convolutions a block")
    return config


def empty_decoder(config: DecoderConfig) -> Decoder:
    """A decoder whose weights take no memory yet, to compare their shapes with.

    Raises:
        ValueError: there would be too many of them.
    """
    with torch.device("meta"):
        decoder = Decoder(config)
    count = sum(value.numel() for value in decoder.state_dict().values())
    if count > _MOST_NUMBERS:
        raise ValueError(f"{count} weights")
    return decoder
