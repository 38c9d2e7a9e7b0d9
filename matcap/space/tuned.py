"""The fine-tuned decoder of a material, and its part of a material's file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.example.stored import example_of
from matcap.field.header import REMEDY
from matcap.field.material import Material
from matcap.field.plane import Period, check_period, check_seed
from matcap.files.tensors import StoredTensors
from matcap.files.values import bounded
from matcap.flash.geometry import FlashSetup
from matcap.space.decoder import ALIGNMENT, CODE_SIZE, Decoder, Moments
from matcap.space.drawing import Drawing
from matcap.space.freeze import FoldedDecoder, fold
from matcap.space.source import DecoderSource
from matcap.space.stored import config_document, decoder_config, empty_decoder
from matcap.statistics.lattice import Wave

_CPU = torch.device("cpu")


@dataclass(frozen=True)
class TunedDecoder:
    """The decoder of one material."""

    decoder: Decoder
    """The decoder, with fine-tuned weights."""
    code: Tensor
    """(CODE_SIZE,) latent vector it was fine-tuned at."""
    moments: tuple[Moments, ...]
    """Frozen AdaIN statistics, one pair a layer."""
    waves: tuple[Wave, ...]
    """Frequencies of the material's lattice; empty for most materials."""
    texel_size: float
    """A texel's side, plane units."""
    drawing: Drawing | None = None
    """What it reads besides noise, or None as in the paper."""
    turned: bool = False
    """Whether its field is rotated upright, 90 degrees clockwise, of a portrait."""

    @property
    def alignment(self) -> int:
        """Texels: periods of its field are multiples of this."""
        return ALIGNMENT if self.drawing is None else max(ALIGNMENT, self.drawing.alignment)

    @property
    def piece_size(self) -> None:
        """None: there is no exemplar."""
        return None

    def piece(self) -> None:
        """None: there is no exemplar."""
        return None

    def material(
        self, name: str, setup: FlashSetup, provenance: Mapping[str, Any] | None = None
    ) -> Material:
        """A material with this decoder as its only generator; arguments as in Material."""
        tuned = replace(self, turned=setup.turned)
        return Material(name, {"decoder": tuned}, self.texel_size, setup, provenance or {})

    @cached_property
    def folded(self) -> FoldedDecoder:
        """The decoder with AdaIN folded into its convolutions."""
        return fold(self.decoder, self.code, self.moments, has_waves=bool(self.waves))

    def source(
        self, seed: int, period: Period | None = None, device: torch.device = _CPU
    ) -> DecoderSource:
        """The field of a seed and period, computed on a device.

        Raises:
            UsageError: a seed or period out of range.
        """
        check_seed(seed)
        check_period(period, self.alignment)
        field = (self.folded.to(device), self.waves, self.texel_size, seed, period)
        return DecoderSource(*field, drawing=self.drawing, turned=self.turned)

    def varied(self, variety: float) -> TunedDecoder:
        """Decoders have no variety.

        Raises:
            UsageError: always.
        """
        raise UsageError.at(
            "--variety",
            f"a decoder rearranges no patches, so it has no variety of {variety:g}",
            "leave it out",
        )

    def repeating(self) -> MapSet:
        """Decoders have no exemplar to make a tile of.

        Raises:
            UsageError: always.
        """
        raise UsageError.at(
            "--tile piece",
            "a decoder has no exemplar to repeat",
            "give --tile alone for a periodic texture, or capture with --generator example",
        )

    def in_file(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Tensors by name, and entries of the JSON description; the inverse of read()."""
        tensors = {f"decoder.{k}": v for k, v in self.decoder.state_dict().items()}
        tensors["code"] = self.code
        for index, (mean, deviation) in enumerate(self.moments):
            tensors[f"moments.{index}.mean"] = mean
            tensors[f"moments.{index}.deviation"] = deviation
        about = {
            "decoder": config_document(self.decoder.config),
            "waves": [wave._asdict() for wave in self.waves],
        }
        if self.drawing is not None:
            read, described = self.drawing.example.in_file("drawing")
            tensors |= read
            about |= described
        return tensors, about


def read(about: Mapping[str, Any], file: safe_open, path: Path) -> TunedDecoder | None:
    """Read the decoder of a material's file, or None if it has none.

    Args:
        about: the file's JSON description.
        file: opened for PyTorch.

    Raises:
        MatcapError: a tensor is missing or of a wrong shape.
        DAMAGED (field/header.py): the description is malformed.
    """
    if "decoder" not in about:
        return None
    stored = StoredTensors(file, path, REMEDY)
    config = decoder_config(about["decoder"])
    decoder = stored.load(empty_decoder(config), "decoder.")
    code = stored.tensor("code", (CODE_SIZE,))
    moments = []
    for index, layer in enumerate(decoder.layers()):
        shape = (layer.convolution.weight.shape[0],)
        mean = stored.tensor(f"moments.{index}.mean", shape)
        deviation = stored.tensor(f"moments.{index}.deviation", shape)
        moments.append((mean, deviation))
    return TunedDecoder(
        decoder=decoder,
        code=code,
        moments=tuple(moments),
        waves=tuple(
            Wave(bounded(w["fx"], "fx", -1.0, 1.0), bounded(w["fy"], "fy", -1.0, 1.0))
            for w in about["waves"][:2]
        ),
        texel_size=bounded(about["texel_size"], "texel_size", 1e-9, 1e3),
        drawing=Drawing(example_of(about, file, "drawing")) if config.drawing else None,
        turned=about["setup"]["turned"],
    )
