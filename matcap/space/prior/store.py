"""Prior: the trained networks and the model of their space, and its file.

One safetensors file: encoder and decoder in half precision, the conditional mean, anchors, and JSON
metadata. Nothing in it is executed; every shape is checked against the description, and an error
names the tensor. The alignment branch has a file of its own (space/alignment.py), as captures need
it without the prior.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from torch import Tensor

from matcap.errors import MatcapError, UsageError
from matcap.field.draw_options import SPREAD
from matcap.field.header import DAMAGED
from matcap.field.material import Material
from matcap.files.tensors import StoredTensors, write_tensors
from matcap.flash.coarse.fit import CoarseFit, fit_coarse
from matcap.flash.geometry import FlashSetup
from matcap.flash.plane import Plane, read_plane
from matcap.photo.photo import Photo
from matcap.space.decoder import CODE_SIZE, Decoder
from matcap.space.encoder import BACKBONES, Encoder, EncoderConfig
from matcap.space.freeze import freeze
from matcap.space.picture import picture
from matcap.space.prior.anchors import Anchor, Anchors, ConditionalMean, origin
from matcap.space.prior.base import VARYING, base_of, fold
from matcap.space.prior.encoder_input import describe_windows, numbers, texture
from matcap.space.stored import config_document, decoder_config, empty_decoder
from matcap.space.tuned import TunedDecoder
from matcap.space.tuning.start import log_contrast
from matcap.statistics.lattice import find_lattice

FORMAT = "matcap-prior"
# Version 2 added structured noise; version 3 moved the alignment branch to its own file.
VERSIONS = (1, 2, 3)
SHIPPED = Path(__file__).parent / "weights" / "prior.safetensors"

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
    """Latent vector and noise to outputs relative to the base (base.py)."""
    conditional_mean: ConditionalMean
    """Model of bases given latent vectors."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """How it was trained; JSON."""
    anchors: Anchors | None = None
    """Anchors of the training photographs; None draws from the standard normal."""

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
        code = self.code(photo.pixels, coarse, plane)
        base = base_of(coarse, log_contrast(plane.linear, plane.valid))
        waves = find_lattice(plane.encoded(), plane.valid).waves
        return Anchor(code, self.conditional_mean.rest(code, base), waves)

    def draw(
        self,
        seed: int,
        *,
        near: Anchor | None = None,
        spread: float = SPREAD,
        name: str = "drawn",
    ) -> Material:
        """Draw a material.

        Args:
            seed: a 64-bit integer.
            near: anchor to draw near; None is a random one of the prior's.
            spread: distance t from the anchor, in [0, 1]; see anchors.py.
            name: of the material; the seed is appended.

        Raises:
            UsageError: a spread outside [0, 1].
        """
        if not 0.0 <= spread <= 1.0:
            raise UsageError(f"the spread {spread:g} is not between 0 and 1", where="-t")
        generator = torch.Generator().manual_seed(seed)
        if near is not None:
            anchor = near.near(spread, generator)
        elif self.anchors is not None:
            anchor = self.anchors.draw(spread, generator)
        else:
            anchor = origin().near(1.0, generator)
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
        if self.anchors is not None:
            tensors |= {f"anchors.{name}": tensor for name, tensor in vars(self.anchors).items()}
        about = {
            "format": FORMAT,
            "version": VERSIONS[-1],
            "encoder": asdict(self.encoder.config),
            "decoder": config_document(self.decoder.config),
            "anchors": 0 if self.anchors is None else len(self.anchors),
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
                about=about["about"],
                anchors=_anchors(stored, int(about.get("anchors", 0))),
            )
    except (SafetensorError, OSError) as error:
        raise MatcapError.at(
            path, f"this is not a prior, or it is damaged ({error})", _REMEDY
        ) from error
    except DAMAGED as error:
        raise MatcapError.at(
            path, f"the prior's description is damaged ({error})", _REMEDY
        ) from error


def _anchors(stored: StoredTensors, count: int) -> Anchors | None:
    """Read the anchors; None if there are none, as in the first priors."""
    if not count:
        return None
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
    config = EncoderConfig(backbone=str(stated["backbone"]), width=int(stated["width"]))
    if config.backbone not in BACKBONES or not 32 <= config.width <= 2048:
        raise ValueError(f"encoder {config}")
    return config
