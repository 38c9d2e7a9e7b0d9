"""A decoder's configuration from a file, checked, as the file may be hostile."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import torch

from matcap.space.decoder import DEPTH, DRAWING_CHANNELS, Decoder, DecoderConfig

# Limits of the memory that a hostile file can claim.
_LARGEST_WIDTH = 1024  # channels
_MOST_CELLS = 64  # channels at full resolution
_MOST_NUMBERS = 64_000_000  # weights, a quarter of a gigabyte


def decoder_config(stated: Mapping[str, Any]) -> DecoderConfig:
    """The configuration in a file's JSON description.

    Raises:
        ValueError, KeyError, IndexError, TypeError: an entry is missing or out of range.
    """
    config = DecoderConfig(
        noise_channels=int(stated["noise_channels"]),
        widths=tuple(int(width) for width in stated["widths"]),
        convolutions=(int(stated["convolutions"][0]), int(stated["convolutions"][1])),
        cells=int(stated["cells"]),
        drawing=int(stated.get("drawing", 0)),  # absent in the shipped prior
    )
    sizes = (config.noise_channels, *config.widths)
    if len(config.widths) != DEPTH + 1 or not all(1 <= s <= _LARGEST_WIDTH for s in sizes):
        raise ValueError(f"widths {config.widths} are not {DEPTH + 1} of at most {_LARGEST_WIDTH}")
    if not 0 <= config.cells <= _MOST_CELLS:
        raise ValueError(f"{config.cells} channels of cells")
    if stated.get("grains", 0) != 0:  # of earlier versions, by recipes that asked for it
        raise ValueError("a decoder of structured noise")
    if config.drawing not in (0, DRAWING_CHANNELS):
        raise ValueError(f"{config.drawing} channels of a drawing")
    if not all(1 <= count <= 4 for count in config.convolutions):
        raise ValueError(f"{config.convolutions} convolutions a block")
    return config


def config_document(config: DecoderConfig) -> dict[str, Any]:
    """The JSON description of a configuration; the inverse of decoder_config."""
    document = asdict(config)
    if not config.drawing:
        del document["drawing"]
    return document


def empty_decoder(config: DecoderConfig) -> Decoder:
    """A decoder on the meta device, which has shapes but no memory.

    Raises:
        ValueError: it would have too many weights.
    """
    with torch.device("meta"):
        decoder = Decoder(config)
    count = sum(value.numel() for value in decoder.state_dict().values())
    if count > _MOST_NUMBERS:
        raise ValueError(f"{count} weights")
    return decoder
