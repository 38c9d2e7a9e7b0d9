"""Prior: the trained networks, the model of their space with its anchors, and its file."""

from __future__ import annotations

import copy
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from torch import Tensor

from matcap.errors import MatcapError, UsageError
from matcap.field.header import DAMAGED
from matcap.field.material import Latent, Material
from matcap.field.options import SPREAD
from matcap.files.tensors import StoredTensors, write_tensors
from matcap.flash.alignment import picture
from matcap.flash.coarse.fit import CoarseFit, fit_coarse
from matcap.flash.geometry import FlashSetup
from matcap.flash.light import render_rectified
from matcap.flash.rectify import Plane, read_plane
from matcap.photo.photo import Photo
from matcap.space.decoder import CODE_SIZE, DRAWING_CHANNELS, Decoder, DecoderConfig
from matcap.space.encoder import Encoder, EncoderConfig, describe_windows, numbers, texture
from matcap.space.freeze import freeze
from matcap.space.prior import SHIPPED
from matcap.space.tuned import TunedDecoder, config_document, decoder_config, empty_decoder
from matcap.space.tuning.match import head_start, log_contrast
from matcap.statistics.lattice import Wave, find_lattice

# The base: offset and scale of the decoder's raw outputs, from the coarse fit.
#
# raw = mean + deviation * output
#
# The network then learns differences from the coarse fit only. Both fold exactly into the decoder's
# last AdaIN (`fold`), so that a material's decoder outputs raw values.

VARYING = 8  # numbers of a base that differ between materials: 5 means, 3 colour deviations

_CONTRASTS = (0.02, 1.5)  # limits of the deviation of log colour
# Factors on the deviations that a capture starts with; larger for F0 and roughness, whose means
# must be able to change more.
_UNIT = (1.0, 1.0, 1.0, 3.0, 3.0, 1.0)

# Deviations of F0, roughness and height are the same for every photograph.
_ANY = CoarseFit((0.5, 0.5, 0.5), 0.04, 0.5, FlashSetup(), 0.0)


@dataclass(frozen=True)
class Base:
    """Offset and scale of each raw output, (OUTPUTS,) or (B, OUTPUTS) each."""

    mean: Tensor
    deviation: Tensor

    def apply(self, output: Tensor) -> Tensor:
        """Raw values mean + deviation * output, (B, OUTPUTS, H, W)."""
        return self.mean[..., None, None] + self.deviation[..., None, None] * output


def base_of(coarse: CoarseFit, contrast: Tensor) -> Base:
    """The base of a photograph; `contrast` is (3,) from log_contrast."""
    mean, deviation = head_start(coarse, contrast.float().clamp(*_CONTRASTS))
    return Base(mean, deviation * torch.tensor(_UNIT))


def varying(base: Base) -> Tensor:
    """(VARYING,) numbers that differ between bases: means, and logs of colour deviations."""
    return torch.cat([base.mean[:5], base.deviation[:3].log()])


def base_from(numbers: Tensor) -> Base:
    """The inverse of varying()."""
    rest = head_start(_ANY, torch.zeros(3))[1][3:] * torch.tensor(_UNIT[3:])
    low, high = _CONTRASTS
    return Base(
        torch.cat([numbers[:5], torch.zeros(1)]),
        torch.cat([numbers[5:].exp().clamp(low, 1.2 * high), rest]),
    )


def fold(decoder: Decoder, base: Base) -> Decoder:
    """A copy of a decoder with the base folded into its head, so that it outputs raw values."""
    folded = copy.deepcopy(decoder).requires_grad_(True)
    scale = torch.cat([base.deviation, base.deviation])
    shift = torch.cat([base.mean, torch.zeros_like(base.mean)])
    with torch.no_grad():
        affine = folded.head.adain.affine
        affine.weight.mul_(scale[:, None])
        affine.bias.mul_(scale).add_(shift)
    return folded


# Contact sheet of materials.

_COLUMNS = 4  # materials in a row
_TILE = 256  # texels a side
_BRIGHTNESS = 0.25  # mean radiance of every tile


def flash_picture(material: Material, size: int, seed: int) -> Tensor:
    """(3, size, size) radiance of a material under its own flash, seen from straight above."""
    maps = material.maps(size, size, seed=seed)
    with torch.inference_mode():
        return render_rectified(maps, material.setup)


def sample_sheet(materials: Sequence[Material], seed: int) -> NDArray[np.float32]:
    """(rows * _TILE, columns * _TILE, 3) linear image, each material under its own flash.

    Args:
        materials: at least one.
        seed: of the first material's field; each next one adds 1.
    """
    count = len(materials)
    tiles = []
    for index, material in enumerate(materials):
        picture = flash_picture(material, _TILE, seed + index)
        exposed = picture * (_BRIGHTNESS / picture.mean().clamp_min(1e-6))
        tiles.append(exposed.clamp(0.0, 1.0).permute(1, 2, 0).numpy())
    columns = min(_COLUMNS, count)
    blank = np.zeros_like(tiles[0])
    rows = [
        np.concatenate([*row, *([blank] * (columns - len(row)))], axis=1)
        for row in (tiles[i : i + columns] for i in range(0, count, columns))
    ]
    return np.concatenate(rows, axis=0)


# Anchors: the training photographs' positions in the prior's space, and draws near them.
#
# Latent vectors of the training photographs are standardised. But a few hundred points leave most
# of 64 dimensions empty, and the decoder is untrained there. Materials are therefore drawn near
# anchors. An anchor is a latent vector, a base (mean maps) and a lattice. The base is
# modelled as
#
# base = A code + b + L rest,    rest ~ N(0, I).
#
# A draw at distance t of an anchor z = (code, rest) is
#
# sqrt(1 - t^2) z + t e,    e ~ N(0, I),
#
# which is the anchor at t = 0, independent of it at t = 1, and standard normal for any t if z is.
# The lattice is the anchor's.


@dataclass(frozen=True)
class ConditionalMean:
    """Linear-Gaussian model of bases given latent vectors, fitted to the training photographs.

    base = A code + b + L rest,    rest ~ N(0, I)
    """

    matrix: Tensor
    """A, (VARYING, CODE_SIZE)."""
    offset: Tensor
    """Vector b, (VARYING,)."""
    spread: Tensor
    """L, (VARYING, VARYING) lower triangular."""

    def base(self, code: Tensor, rest: Tensor) -> Base:
        """A code + b + L rest; `rest` is (VARYING,)."""
        return base_from(self.matrix @ code + self.offset + self.spread @ rest)

    def rest(self, code: Tensor, base: Base) -> Tensor:
        """(VARYING,) whitened residual L^-1 (base - A code - b)."""
        residual = varying(base) - self.offset - self.matrix @ code
        return torch.linalg.solve_triangular(self.spread, residual[:, None], upper=False)[:, 0]


@dataclass(frozen=True)
class Anchor:
    """A position in the prior's space."""

    code: Tensor
    """(CODE_SIZE,) latent vector."""
    rest: Tensor
    """(VARYING,) whitened residual of the base."""
    waves: tuple[Wave, ...]
    """Lattice, in cycles per texel of a drawn material."""

    def near(self, spread: float, generator: torch.Generator) -> Anchor:
        """Draw a position at distance t = spread, in [0, 1]; equation above ConditionalMean."""
        drawn = torch.randn(CODE_SIZE + VARYING, generator=generator)
        kept = math.sqrt(1.0 - spread**2)
        here = kept * torch.cat([self.code, self.rest]) + spread * drawn
        return Anchor(here[:CODE_SIZE], here[CODE_SIZE:], self.waves)


@dataclass(frozen=True)
class Anchors:
    """Positions of the N training photographs."""

    codes: Tensor
    """(N, CODE_SIZE) standardised latent vectors."""
    rests: Tensor
    """(N, VARYING) whitened residuals of the base maps, `rest` in the module."""
    waves: Tensor
    """(N, 2, 2) frequencies (fx, fy) of two waves; (0, 0) for absent ones."""

    def __len__(self) -> int:
        return len(self.codes)

    def __getitem__(self, index: int) -> Anchor:
        waves = tuple(Wave(fx, fy) for fx, fy in self.waves[index].tolist() if fx or fy)
        return Anchor(self.codes[index], self.rests[index], waves)

    def draw(self, spread: float, generator: torch.Generator) -> Anchor:
        """Draw a position near a random anchor."""
        index = int(torch.randint(len(self), (1,), generator=generator))
        return self[index].near(spread, generator)


# Prior: the trained networks and the model of their space, and its file.
#
# One safetensors file: encoder and decoder in half precision, the conditional mean, anchors, and
# JSON metadata. Nothing in it is executed; every shape is checked against the description, and an
# error names the tensor. The alignment branch has a file of its own (flash/alignment.py), as
# captures need it without the prior.

FORMAT = "matcap-prior"
VERSIONS = (1, 2, 3)
# The prior's decoder, trained on to read drawings.
DRAWING_START = SHIPPED.with_name("drawing.safetensors")

_BACKBONE = "small"  # of the encoder; there is no other
_MOST_ANCHORS = 1_000_000  # limits the memory that a hostile file can claim
DETAIL = 1024  # texels across two plane units of a drawn material
_MEAN_SHAPES = {
    "matrix": (VARYING, CODE_SIZE), "offset": (VARYING,), "spread": (VARYING, VARYING),
}  # fmt: skip
_REMEDY = "install matcap again, or train a prior with `matcap-lab prior train`"


@dataclass(frozen=True)
class Prior:
    """The trained prior."""

    encoder: Encoder
    """Photograph to latent vector."""
    decoder: Decoder
    """Latent vector and noise to outputs relative to the base."""
    conditional_mean: ConditionalMean
    """Model of bases given latent vectors."""
    anchors: Anchors
    """Positions of the training photographs."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """How it was trained; JSON."""
    digest: str = ""
    """SHA-256 of its file."""

    def code(self, pixels: NDArray[np.float32], coarse: CoarseFit, plane: Plane) -> Tensor:
        """(CODE_SIZE,) latent vector of a photograph, the encoder's mean.

        Args:
            pixels: (H, W, 3) linear, of the photograph as taken.
            coarse: its coarse fit.
            plane: the photograph rectified, at the capture's resolution.
        """
        with torch.no_grad():
            shown = picture(pixels, self.encoder.config.width)[None]
            contrast = log_contrast(plane.linear, plane.valid)
            inputs = numbers(coarse, contrast, plane.size[0])[None]
            seen = texture(describe_windows(plane.linear, plane.valid))[None]
            mean, _ = self.encoder(shown, inputs, seen)
        return mean[0]

    def start(
        self, pixels: NDArray[np.float32], coarse: CoarseFit, plane: Plane
    ) -> tuple[Decoder, Tensor]:
        """Decoder, with the base folded in, and latent vector of a photograph; see code()."""
        contrast = log_contrast(plane.linear, plane.valid)
        return fold(self.decoder, base_of(coarse, contrast)), self.code(pixels, coarse, plane)

    def place(self, photo: Photo) -> Anchor:
        """Position of a photograph in the space, rectified at DETAIL texels."""
        coarse = fit_coarse(photo)
        plane = read_plane(photo.linearised(coarse.tone), coarse.setup, DETAIL)
        waves = find_lattice(plane.encoded(), plane.valid).waves
        return self.anchor(photo.pixels, coarse, plane, waves)

    def anchor(
        self, pixels: NDArray[np.float32], coarse: CoarseFit, plane: Plane, waves: tuple[Wave, ...]
    ) -> Anchor:
        """Position of a photograph, of waves in cycles per texel of `plane`; see code()."""
        code, times = self.code(pixels, coarse, plane), plane.size[0] / DETAIL
        base = base_of(coarse, log_contrast(plane.linear, plane.valid))
        waves = tuple(Wave(times * wave.fx, times * wave.fy) for wave in waves)
        return Anchor(code, self.conditional_mean.rest(code, base), waves)

    def kept(self, anchor: Anchor) -> Latent:
        """A position as a material's file has it."""
        return Latent(
            torch.cat([anchor.code, anchor.rest]),
            tuple((wave.fx, wave.fy) for wave in anchor.waves),
            self.digest,
        )

    def near(self, latent: Latent) -> Anchor:
        """The inverse of kept().

        Raises:
            MatcapError: it is of another prior.
        """
        if latent.prior != self.digest:
            raise MatcapError(
                "this material was encoded by another prior",
                remedy="give its photograph, or capture that again",
            )
        waves = tuple(Wave(*wave) for wave in latent.waves)
        return Anchor(latent.code, latent.numbers[CODE_SIZE:], waves)

    def draw(
        self, seed: int, *, near: Anchor | None = None, spread: float = SPREAD, name: str = "drawn"
    ) -> Material:
        """Draw a material.

        Args:
            seed: a 64-bit integer.
            near: anchor to draw near; None is a random one of the prior's.
            spread: distance t from the anchor, in [0, 1] (Anchor.near).
            name: of the material; the seed is appended.

        Raises:
            UsageError: a spread outside [0, 1].
        """
        if not 0.0 <= spread <= 1.0:
            raise UsageError(f"the spread {spread:g} is not between 0 and 1", where="-t")
        generator = torch.Generator().manual_seed(seed)
        if near is not None:
            anchor = near.near(spread, generator)
        else:
            anchor = self.anchors.draw(spread, generator)
        return self.material(f"{name}_{seed}", anchor, {"drawn": seed, "spread": spread})

    def material(self, name: str, anchor: Anchor, provenance: Mapping[str, Any]) -> Material:
        """The frozen material of a position in the space."""
        decoder = fold(self.decoder, self.conditional_mean.base(anchor.code, anchor.rest))
        tuned = TunedDecoder(
            decoder=decoder.eval().requires_grad_(False),
            code=anchor.code,
            moments=tuple(freeze(decoder, anchor.code, anchor.waves)),
            waves=anchor.waves,
            texel_size=2.0 / DETAIL,
        )
        return tuned.material(name, FlashSetup(intensity=(math.pi * 4.0,) * 3), provenance)

    def save(self, path: Path) -> None:
        """Write the file in half precision, atomically."""
        tensors = {
            f"{part}.{name}": tensor.half()
            for part, module in (("encoder", self.encoder), ("decoder", self.decoder))
            for name, tensor in module.state_dict().items()
        }
        for name, tensor in vars(self.conditional_mean).items():
            tensors[f"habits.{name}"] = tensor.float()
        tensors |= {f"anchors.{name}": tensor for name, tensor in vars(self.anchors).items()}
        about = {
            "format": FORMAT,
            "version": VERSIONS[-1],
            "encoder": {"backbone": _BACKBONE, "width": self.encoder.config.width},
            "decoder": config_document(self.decoder.config),
            "anchors": len(self.anchors),
            "about": dict(self.about),
        }
        write_tensors(path, tensors, {"matcap": json.dumps(about)})


def load_prior(path: Path | None = None) -> Prior:
    """Read a prior; None reads the one shipped with matcap.

    Raises:
        MatcapError: missing, not a prior, of another version, or damaged; names the tensor.
    """
    path = SHIPPED if path is None else path
    if not path.is_file():
        what = "this is a folder" if path.is_dir() else "there is no such prior"
        raise MatcapError.at(path, what, _REMEDY)
    try:
        with safe_open(path, framework="pt") as file:
            about = _about(file.metadata(), path)
            stored = StoredTensors(file, path, _REMEDY)
            encoder = Encoder(_encoder_config(about["encoder"]))
            decoder = empty_decoder(decoder_config(about["decoder"]))
            return Prior(
                encoder=stored.load(encoder, "encoder."),
                decoder=stored.load(decoder, "decoder."),
                conditional_mean=ConditionalMean(**_tensors(stored, "habits", _MEAN_SHAPES)),
                anchors=_anchors(stored, int(about["anchors"])),
                about=about["about"],
                digest=hashlib.sha256(path.read_bytes()).hexdigest(),
            )
    except (SafetensorError, OSError) as error:
        raise MatcapError.at(path, "this is not a prior, or it is damaged", _REMEDY) from error
    except DAMAGED as error:
        raise MatcapError.at(
            path, f"the prior's description is damaged ({error})", _REMEDY
        ) from error


def load_drawing_start() -> Decoder:
    """The prior's decoder, trained on to read drawings, relative to the base.

    Raises:
        MatcapError: missing or damaged.
    """
    try:
        with safe_open(DRAWING_START, framework="pt") as file:
            stored = StoredTensors(file, DRAWING_START, _REMEDY)
            return stored.load(empty_decoder(DecoderConfig(drawing=DRAWING_CHANNELS)), "")
    except (SafetensorError, OSError) as error:
        raise MatcapError.at(DRAWING_START, "missing, or damaged", _REMEDY) from error


def _anchors(stored: StoredTensors, count: int) -> Anchors:
    if not 0 < count <= _MOST_ANCHORS:
        raise ValueError(f"{count} anchors")
    shapes = {"codes": (count, CODE_SIZE), "rests": (count, VARYING), "waves": (count, 2, 2)}
    return Anchors(**_tensors(stored, "anchors", shapes))


def _tensors(
    stored: StoredTensors, part: str, shapes: Mapping[str, tuple[int, ...]]
) -> dict[str, Tensor]:
    return {name: stored.tensor(f"{part}.{name}", shape) for name, shape in shapes.items()}


def _about(metadata: Mapping[str, str] | None, path: Path) -> dict[str, Any]:
    if not metadata or "matcap" not in metadata:
        raise MatcapError.at(path, "this safetensors file is not a matcap prior", _REMEDY)
    about: dict[str, Any] = json.loads(metadata["matcap"])
    if about["format"] != FORMAT:
        raise MatcapError.at(path, f"this holds a {about['format']}, not a prior", _REMEDY)
    if about["version"] not in VERSIONS:
        raise MatcapError.at(
            path,
            f"this prior is of version {about['version']}; this matcap reads {VERSIONS[0]} to "
            f"{VERSIONS[-1]}",
            _REMEDY,
        )
    return about


def _encoder_config(stated: Mapping[str, Any]) -> EncoderConfig:
    if stated["backbone"] != _BACKBONE or not 32 <= int(stated["width"]) <= 2048:
        raise ValueError(f"encoder {stated}")
    return EncoderConfig(int(stated["width"]))
