"""Material: a captured material and its file, `.matcap`.

One safetensors file of float32 tensors and bytes, whose metadata has two entries: `matcap`, which
is JSON, and `digest`, SHA-256 of that text and all tensors' bytes, checked on loading; files
written before there was one have none. Nothing in it is executed, and every shape is checked
against the stated configuration before anything is read.

Tensors:
    decoder.*: the fine-tuned network; shapes as the configuration says.
    code: (64,), the material's code.
    moments.*.mean: (channels of layer *,), frozen mean of its AdaIN's input.
    moments.*.deviation: (channels of layer *,), frozen deviation of it.
    example.exemplar.*: bytes, one map of the photographed piece each; see exemplar.py.
    example.index.*: bytes, what rearranging it looks up; see example/index.py.

Metadata:
    format: "matcap-material".
    version: 2 where the decoder reads structured noise, else 1.
    name: of the photograph.
    decoder: `noise_channels`, `widths` (five), `convolutions` (down, up) and `cells` (channels of
        the noise of cells, 0 or absent for none) and `grains` (of structured noise, likewise).
    waves: at most two of `{fx, fy}`, cycles a texel; the plane waves of regular order.
    texel_size: plane units.
    setup: camera and flash: `fov` (degrees), `offset`, `tilt` (radians), `intensity`, `vignetting`.
    provenance: how it was made.
    example: `exemplar` and `index`, what their tensors mean; absent where there is none.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.files.tensors import write_tensors
from matcap.flash.geometry import FlashSetup
from matcap.model.decoder import ALIGNMENT, CODE_SIZE, Decoder, Moments
from matcap.model.example.example import Example
from matcap.model.exemplar import Exemplar
from matcap.model.field import Field
from matcap.model.freeze import FoldedDecoder, fold
from matcap.model.header import (
    EXAMPLE,
    FORMAT,
    REMEDY,
    VERSIONS,
    opened,
    plain_name,
    read_example,
)
from matcap.model.source import Generator, no_exemplar
from matcap.model.stored import StoredTensors, decoder_config, described, empty_decoder
from matcap.statistics.lattice import Wave


@dataclass(frozen=True)
class Material:
    """A generator of maps.

    Attributes:
        name: of the photograph it came from.
        decoder: fine-tuned weights.
        code: (CODE_SIZE,) where the decoder was tuned.
        moments: frozen AdaIN statistics, one pair a layer.
        waves: the plane waves of its regular order; none for most materials.
        texel_size: in plane units (half the photograph's long side).
        setup: camera and flash of the photograph.
        provenance: anything worth knowing about how it was made; JSON.
        example: maps of the photographed piece, indexed to be rearranged; materials captured
            before there were any have none, and only their decoder.
    """

    name: str
    decoder: Decoder
    code: Tensor
    moments: tuple[Moments, ...]
    waves: tuple[Wave, ...]
    texel_size: float
    setup: FlashSetup
    provenance: Mapping[str, Any] = field(default_factory=dict)
    example: Example | None = None

    @property
    def exemplar(self) -> Exemplar | None:
        """Maps of the photographed piece, if they were made."""
        return None if self.example is None else self.example.exemplar

    def by(self, generator: Generator | None) -> Material:
        """The same with one generator alone; with both where none is named.

        Raises:
            UsageError: it has no exemplar, and is to be read by example.
        """
        if generator == "decoder":
            return replace(self, example=None)
        if generator == "example" and self.example is None:
            raise no_exemplar()
        return self

    @property
    def alignment(self) -> int:
        """What periods of its field are multiples of, in texels."""
        return ALIGNMENT if self.example is None else self.example.alignment

    @cached_property
    def _folded(self) -> FoldedDecoder:
        return fold(self.decoder, self.code, self.moments, has_waves=bool(self.waves))

    def folded(self) -> FoldedDecoder:
        """The frozen network: plain convolutions on noise."""
        return self._folded

    def maps(
        self,
        width: int,
        height: int,
        *,
        seed: int = 0,
        x: int = 0,
        y: int = 0,
        period: tuple[int, int] | None = None,
        generator: Generator | None = None,
    ) -> MapSet:
        """Maps of a rectangle of the endless field; see model.field.Field.read.

        Args:
            width: in texels.
            height: in texels.
            seed: which realisation.
            x: of the left top texel.
            y: of the left top texel, downwards.
            period: repeat of the field in texels, or None for an endless one.
            generator: "example" or "decoder"; by default by example where there is an exemplar.
        """
        return Field(self, seed, period, generator=generator).read(x, y, width, height)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the file; whole or not at all.

        Raises:
            MatcapError: the folder cannot be written, or the disk is full.
        """
        tensors = {f"decoder.{k}": v for k, v in self.decoder.state_dict().items()}
        tensors["code"] = self.code
        for index, (mean, deviation) in enumerate(self.moments):
            tensors[f"moments.{index}.mean"] = mean
            tensors[f"moments.{index}.deviation"] = deviation
        about = {
            "format": FORMAT,
            "version": VERSIONS[bool(self.decoder.config.grains)],
            "name": self.name,
            "decoder": described(self.decoder.config),
            "waves": [asdict(wave) for wave in self.waves],
            "texel_size": self.texel_size,
            "setup": asdict(self.setup),
            "provenance": dict(self.provenance),
        }
        if self.example is not None:
            found, about["example"] = self.example.stored()
            tensors |= {
                EXAMPLE + name: torch.from_numpy(data.copy()) for name, data in found.items()
            }
        write_tensors(Path(path), tensors, {"matcap": json.dumps(about)})

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Material:
        """Read a `.matcap` file.

        Raises:
            MatcapError: missing, not a material, of another version, or damaged; names the tensor.
        """
        path = Path(path)
        with opened(path, "pt") as (file, about):
            stored = StoredTensors(file, path, REMEDY)
            decoder = empty_decoder(decoder_config(about["decoder"]))
            state = {
                name: stored.tensor(f"decoder.{name}", tuple(value.shape))
                for name, value in decoder.state_dict().items()
            }
            decoder.load_state_dict(state, assign=True)
            code = stored.tensor("code", (CODE_SIZE,))
            moments = []
            for index, layer in enumerate(decoder.layers()):
                shape = (layer.convolution.weight.shape[0],)
                mean = stored.tensor(f"moments.{index}.mean", shape)
                deviation = stored.tensor(f"moments.{index}.deviation", shape)
                moments.append((mean, deviation))
            return Material(
                name=plain_name(str(about["name"])),
                decoder=decoder.eval().requires_grad_(False),
                code=code,
                moments=tuple(moments),
                waves=_waves(about["waves"]),
                texel_size=_number(about, "texel_size", 1e-9, 1e3),
                setup=stated_setup(about["setup"]),
                provenance=dict(about["provenance"]),
                example=read_example(about, lambda name: file.get_tensor(name).numpy()),
            )


def _waves(stated: list[Mapping[str, Any]]) -> tuple[Wave, ...]:
    return tuple(Wave(_number(w, "fx", -1.0, 1.0), _number(w, "fy", -1.0, 1.0)) for w in stated[:2])


def stated_setup(stated: Mapping[str, Any]) -> FlashSetup:
    """The setup that a file states.

    Raises:
        KeyError, TypeError, ValueError: something is missing, of another kind or out of range.
    """
    ox, oy, oz = (_bounded(v, "offset", -1e3, 1e3) for v in stated["offset"])
    red, green, blue = (_bounded(v, "intensity", 0.0, 1e12) for v in stated["intensity"])
    tilt_x, tilt_y = (_bounded(v, "tilt", -1.5, 1.5) for v in stated["tilt"])
    return FlashSetup(
        fov=_number(stated, "fov", 1.0, 170.0),
        offset=(ox, oy, oz),
        tilt=(tilt_x, tilt_y),
        intensity=(red, green, blue),
        vignetting=_number(stated, "vignetting", -20.0, 20.0),
    )


def _number(stated: Mapping[str, Any], name: str, least: float, most: float) -> float:
    return _bounded(stated[name], name, least, most)


def _bounded(value: float, name: str, least: float, most: float) -> float:
    """A number within limits; NaN is in none."""
    number = float(value)
    if not least <= number <= most:
        raise ValueError(f"{name} is {number:g}")
    return number
