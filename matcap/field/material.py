"""Material: a captured material and its file, `.matcap`.

One safetensors file of tensors, whose metadata has two entries: `matcap`, which is JSON, and
`digest`, SHA-256 of that text and all tensors' bytes, checked on loading. Nothing in it is
executed, and every shape is checked against the stated configuration before anything is read.

Tensors:
    example.exemplar.*: bytes, one map of the photographed piece each; see example/exemplar.py.
    example.index.*: bytes, what rearranging it looks up; see example/index.py.
    decoder.*: the fine-tuned network, where one was asked for; shapes as its description says.
    code: (64,), the code it was tuned at.
    moments.*.mean: (channels of layer *,), frozen mean of its AdaIN's input.
    moments.*.deviation: (channels of layer *,), frozen deviation of it.

Metadata:
    format: "matcap-material".
    version: 5.
    name: of the photograph.
    texel_size: plane units.
    setup: camera and flash: `fov` (degrees), `offset`, `tilt` (radians), `intensity`, `vignetting`,
        `vignetting_quartic`, `turned` (of a portrait: both are of the picture lying, maps stand).
    provenance: how it was made.
    example: `exemplar` and `index`, what their tensors mean; absent where there is none.
    decoder: `noise_channels`, `widths` (five), `convolutions` (down, up) and `cells` (channels of
        the noise of cells, 0 for none) and `grains` (of structured noise, likewise);
        absent where there is none.
    waves: at most two of `{fx, fy}`, cycles a texel; the plane waves of a decoder's regular order.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.field.field import Field
from matcap.field.header import FORMAT, VERSION, opened
from matcap.field.source import FieldGenerator, Generator
from matcap.files.tensors import write_tensors
from matcap.flash.geometry import FlashSetup

# Who reads each generator from a file, imported where a file holds one; the first that a material
# has makes its maps.
GENERATORS: Mapping[Generator, str] = {
    "example": "matcap.example.stored",
    "decoder": "matcap.space.tuned",
}
_CODES = "matcap.space.code"  # who works out a code, imported when one is asked for


PartKind = TypeVar("PartKind")


@dataclass(frozen=True)
class Material:
    """An endless material."""

    name: str
    """Of the photograph it came from."""
    generators: Mapping[Generator, FieldGenerator]
    """What makes its maps, by name: "example" for the photographed piece, rearranged; "decoder" for
    the paper's network, where it was asked for."""
    texel_size: float
    """In plane units (half the photograph's long side)."""
    setup: FlashSetup
    """Camera and flash of the photograph."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """Anything worth knowing about how it was made; JSON."""

    def part(self, kind: type[PartKind]) -> PartKind | None:
        """Its generator of a class, if it has one."""
        return next((g for g in self.generators.values() if isinstance(g, kind)), None)

    @property
    def generator(self) -> FieldGenerator:
        """The one that makes its maps: by example, unless it only has a decoder."""
        return next(self.generators[name] for name in GENERATORS if name in self.generators)

    def by(self, generator: Generator | None) -> Material:
        """The same with one generator alone; with all where none is named.

        Raises:
            UsageError: it has no such generator.
        """
        if generator is None:
            return self
        if generator not in self.generators:
            raise lacking(generator)
        return replace(self, generators={generator: self.generators[generator]})

    def varied(self, variety: float | None) -> Material:
        """The same, its piece rearranged with another variety; itself where none is named.

        Args:
            variety: from 0, the piece itself repeated, to 1, of many small pieces.

        Raises:
            UsageError: it has no exemplar, or a variety out of range.
        """
        if variety is None:
            return self
        name = next(name for name in GENERATORS if name in self.generators)
        varied = self.generators[name].varied(variety)
        return replace(self, generators={**self.generators, name: varied})

    def repeating(self) -> MapSet:
        """Maps of the photographed piece itself, made to repeat, at about its own size.

        Raises:
            UsageError: it holds no piece, or too small a one.
        """
        return self.generator.repeating()

    @property
    def alignment(self) -> int:
        """What periods of its field are multiples of, in texels."""
        return self.generator.alignment

    @cached_property
    def code(self) -> Tensor:
        """(64,) where it lies in the paper's space; worked out when it is first asked for."""
        latent: Tensor = import_module(_CODES).code_of(self)
        return latent

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
        """Maps of a rectangle of the endless field; see field.field.Field.read.

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
        tensors: dict[str, Tensor] = {}
        about: dict[str, Any] = {
            "format": FORMAT,
            "version": VERSION,
            "name": self.name,
            "texel_size": self.texel_size,
            "setup": asdict(self.setup),
            "provenance": dict(self.provenance),
        }
        for part in self.generators.values():
            arrays, described = part.in_file()
            tensors |= arrays
            about |= described
        write_tensors(Path(path), tensors, {"matcap": json.dumps(about)})

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Material:
        """Read a `.matcap` file.

        Raises:
            MatcapError: missing, not a material, of another version, or damaged; names the tensor.
        """
        path = Path(path)
        with opened(path, "pt") as (file, about):
            generators = {
                name: import_module(GENERATORS[name]).read(about, file, path)
                for name in GENERATORS
                if name in about
            }
            if not generators:
                raise ValueError("nothing in it makes maps")
            return Material(
                name=about["name"],
                generators=generators,
                texel_size=about["texel_size"],
                setup=FlashSetup(**about["setup"]),
                provenance=about["provenance"],
            )


def lacking(generator: Generator) -> UsageError:
    """What a material cannot do that lacks a generator."""
    if generator == "decoder":
        return UsageError(
            "this material has no decoder of its own",
            where="--generator decoder",
            remedy="capture the photograph with --generator decoder, or leave the option out",
        )
    return UsageError(
        "this material has no exemplar",
        where="--generator example",
        remedy="capture the photograph again, or use its decoder",
    )
