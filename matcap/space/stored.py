"""The shape of a decoder as a file that a stranger may have written describes it: bounded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from matcap.space.decoder import DEPTH, Decoder, DecoderConfig
from matcap.space.structured_noise import GRAIN_CHANNELS

_LARGEST_WIDTH = 1024  # channels; a stranger's file cannot ask for more memory than this allows
_MOST_CELLS = 64  # channels at full resolution, whatever the network makes of them
_MOST_NUMBERS = 64_000_000  # weights; a quarter of a gigabyte


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
