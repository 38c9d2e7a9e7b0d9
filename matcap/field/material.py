"""Material: a captured material and its file, `.matcap`.

One safetensors file of tensors, whose metadata has two entries: `matcap`, which is JSON, and
`digest`, the SHA-256 of that text and of all tensors' bytes, checked on loading. Nothing in it is
executed, and every shape is checked against the description before a tensor is read.

Tensors:
    example.exemplar.*: bytes, one map of the exemplar each; see example/exemplar.py.
    example.index.*: bytes of the exemplar's index; see example/index.py.
    decoder.*: weights of the fine-tuned decoder, where there is one.
    drawing.*: as example.*, of the exemplar that the decoder draws from, if it does.
    code: (64,), the latent vector it was fine-tuned at.
    latent: (72,), the photograph's position in the prior's space: code, then what else mean maps
        have (space/prior/store.py); absent in older files.
    moments.*.mean: (channels of layer *,), frozen mean of its AdaIN's input.
    moments.*.deviation: (channels of layer *,), frozen standard deviation of it.

Metadata:
    format: "matcap-material".
    version: 5, or 6 with two generators.
    name: of the photograph.
    texel_size: of the default generator, plane units.
    setup: camera and flash: `fov` (degrees), `offset`, `tilt` (radians), `intensity`, `vignetting`,
        `vignetting_quartic`, `vignetting_centre`, `vignetting_colour` (absent: 0), and `turned`:
        true where setup is of the photograph in landscape orientation and the maps are in portrait.
    provenance: how it was made.
    example: `exemplar` and `index`, descriptions of their tensors; absent without an exemplar.
    drawing: as example, of that exemplar; without its descriptions where it is the material's own.
        `finer`: its texels along one of the decoder's, 1 if absent; `turned`: if it is upright.
    generator: which of two makes its maps by default; absent with one.
    decoder: `noise_channels`, `widths` (five), `convolutions` (down, up), `cells` and `drawing`
        (channels of lattice cells and of the drawing, 0 or 2); absent without a decoder.
    waves: at most two `{fx, fy}`, cycles per texel: the decoder's lattice.
    latent: `prior`, the SHA-256 of its file, and `waves` of the photograph, cycles per texel
        of a drawn material.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.errors import UsageError
from matcap.field.field import Field
from matcap.field.header import FORMAT, VERSION, VERSIONS, opened
from matcap.field.source import FieldGenerator, Generator
from matcap.files.settings import bounded
from matcap.files.tensors import write_tensors
from matcap.flash.geometry import FlashSetup

# Modules that read each generator from a file, imported on demand; the second may draw from the
# first one's exemplar.
GENERATORS: Mapping[Generator, str] = {
    "example": "matcap.example.example",
    "decoder": "matcap.space.tuned",
}

PartKind = TypeVar("PartKind")

CODE, LATENT = 64, 72  # numbers of a latent vector, and of a position in the prior's space


@dataclass(frozen=True)
class Latent:
    """A photograph's position in the space of a prior."""

    numbers: Tensor
    """(LATENT,)."""
    waves: tuple[tuple[float, float], ...]
    """Its lattice, cycles per texel of a drawn material."""
    prior: str
    """SHA-256 of the prior's file."""

    @property
    def code(self) -> Tensor:
        """(CODE_SIZE,) the latent vector that decoders take."""
        return self.numbers[:CODE].clone()  # files hold no tensor twice

    @property
    def entry(self) -> dict[str, Any]:
        """The description for a file."""
        return {"prior": self.prior, "waves": [list(wave) for wave in self.waves]}

    @staticmethod
    def read(entry: Mapping[str, Any], numbers: Tensor) -> Latent:
        """The inverse of `entry`, checked.

        Raises:
            DAMAGED (field/header.py): an entry is malformed.
        """
        if numbers.shape != (LATENT,) or not numbers.isfinite().all():
            raise ValueError(f"latent is not {LATENT} numbers")
        waves = tuple(
            (bounded(fx, "fx", -1.0, 1.0), bounded(fy, "fy", -1.0, 1.0))
            for fx, fy in entry["waves"][:2]
        )
        return Latent(numbers.float(), waves, str(entry["prior"])[:64])


@dataclass(frozen=True)
class Material:
    """An endless material."""

    name: str
    """Name of the photograph it was captured from."""
    generators: Mapping[Generator, FieldGenerator]
    """By name: "example" rearranges the exemplar, "decoder" is the fine-tuned network."""
    texel_size: float
    """Side of a texel in plane units (half the photograph's long side)."""
    setup: FlashSetup
    """Camera and flash of the photograph."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """Record of how it was made; JSON."""
    default: Generator | None = None
    """Which of two generators makes its maps; None is "example"."""
    latent: Latent | None = None
    """The photograph's position in the prior's space; None where it was not encoded."""

    def part(self, kind: type[PartKind]) -> PartKind | None:
        """The generator of this class, or None."""
        return next((g for g in self.generators.values() if isinstance(g, kind)), None)

    @property
    def made_by(self) -> Generator:
        """Name of the generator that makes its maps: the default, or the only one."""
        wanted = (self.default, *GENERATORS)
        return next(name for name in wanted if name is not None and name in self.generators)

    @property
    def generator(self) -> FieldGenerator:
        """The generator that makes its maps."""
        return self.generators[self.made_by]

    def by(self, generator: Generator | None) -> Material:
        """Return a copy with only this generator; the material itself for None.

        Raises:
            UsageError: it has no such generator.
        """
        if generator is None:
            return self
        if generator not in self.generators:
            raise lacking(self.name, generator)
        made = self.generators[generator]
        size = self.texel_size if len(self.generators) == 1 else made.texel_size
        return replace(self, generators={generator: made}, texel_size=size, default=None)

    def preferring(self, generator: Generator) -> Material:
        """A copy with two generators of which this one makes its maps."""
        size = self.generators[generator].texel_size
        return replace(self, texel_size=size, default=generator)

    def varied(self, variety: float | None) -> Material:
        """Return a copy whose field has another variety; the material itself for None.

        Args:
            variety: patch size, from 0, the whole exemplar, to 1, the smallest patches.

        Raises:
            UsageError: it has no exemplar, or a variety out of range.
        """
        if variety is None:
            return self
        varied = self.generator.varied(variety)
        return replace(self, generators={**self.generators, self.made_by: varied})

    def repeating(self) -> MapSet:
        """Maps of the exemplar as a seamless tile; see example/repeat.

        Raises:
            UsageError: there is no exemplar, or it is too small.
        """
        return self.generators.get("example", self.generator).repeating()

    @property
    def alignment(self) -> int:
        """Texels: periods of its field are multiples of this."""
        return self.generator.alignment

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
        """Compute maps of a rectangle of the endless field; see field.field.Field.

        Args:
            width: in texels.
            height: in texels.
            seed: of the realisation.
            x: column of the upper left texel.
            y: row of the upper left texel, downwards.
            period: (x, y) repeat of the field in texels, or None for an endless field.
            generator: "example" or "decoder"; None is the material's default.
        """
        return Field(self, seed, period, generator=generator).read(x, y, width, height)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the file atomically.

        Raises:
            MatcapError: the folder cannot be written, or the disk is full.
        """
        tensors: dict[str, Tensor] = {}
        about: dict[str, Any] = {
            "format": FORMAT,
            "version": VERSIONS[-1] if len(self.generators) > 1 else VERSION,
            "name": self.name,
            "texel_size": self.texel_size,
            "setup": {
                key: value
                for key, value in asdict(self.setup).items()
                # Absent where they are 0, as in files of before they were fitted.
                if key not in ("vignetting_centre", "vignetting_colour") or any(value)
            },
            "provenance": dict(self.provenance),
        }
        if len(self.generators) > 1:
            about["generator"] = self.made_by
        by_example = self.generators.get("example")
        for part in self.generators.values():
            arrays, described = part.in_file(by_example)
            tensors |= arrays
            about |= described
        if self.latent is not None:
            tensors["latent"], about["latent"] = self.latent.numbers, self.latent.entry
        write_tensors(Path(path), tensors, {"matcap": json.dumps(about)})

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Material:
        """Read a `.matcap` file.

        Raises:
            MatcapError: missing, not a material, of another version, or damaged; names the tensor.
        """
        path = Path(path)
        with opened(path, "pt") as (file, about):
            generators: dict[Generator, FieldGenerator] = {}
            for name in (name for name in GENERATORS if name in about):
                by_example = generators.get("example")
                reader = import_module(GENERATORS[name])
                generators[name] = reader.read(about, file, path, by_example)
            if not generators:
                raise ValueError("nothing in it makes maps")
            return Material(
                name=about["name"],
                generators=generators,
                texel_size=about["texel_size"],
                setup=FlashSetup(**about["setup"]),
                provenance=about["provenance"],
                default=about.get("generator"),
                latent=Latent.read(about["latent"], file.get_tensor("latent"))
                if "latent" in about
                else None,
            )


def lacking(material: str, generator: Generator) -> UsageError:
    """The error for a material, by its name, without this generator."""
    if generator == "decoder":
        return UsageError.at(
            "--generator decoder",
            f"{material} has no decoder of its own",
            "capture the photograph with --generator decoder, or leave the option out",
        )
    return UsageError.at(
        "--generator example",
        f"{material} has no exemplar",
        "capture the photograph again, or use its decoder",
    )
