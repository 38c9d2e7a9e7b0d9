"""Prior: the trained space of materials and its file.

One safetensors file: encoder, decoder and alignment branch in half precision, what is needed to
draw materials from nothing, and JSON metadata as strings. Nothing in it is executed; every shape
is checked against the stated configuration, and an error names the tensor.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from matcap.capture.coarse import CoarseFit
from matcap.capture.prior.base import VARYING, Base, base_from, base_of, fold
from matcap.capture.prior.look import describe_windows, numbers, picture, texture
from matcap.capture.start import log_contrast
from matcap.errors import MatcapError
from matcap.files.tensors import write_tensors
from matcap.flash.geometry import FlashSetup
from matcap.flash.plane import Plane
from matcap.model.alignment import WIDTH, Alignment
from matcap.model.decoder import CODE_SIZE, Decoder
from matcap.model.encoder import BACKBONES, Encoder, EncoderConfig
from matcap.model.freeze import freeze
from matcap.model.header import DAMAGED
from matcap.model.material import Material
from matcap.model.stored import StoredTensors, decoder_config, empty_decoder
from matcap.photo.photo import Photo

FORMAT = "matcap-prior"
VERSION = 1  # of the file
SHIPPED = Path(__file__).parent / "weights" / "prior.safetensors"

_DETAIL = 1024  # texels across the photograph a drawn material is meant for
_REMEDY = "install matcap again, or train a prior with `matcap prior train`"


@dataclass(frozen=True)
class Habits:
    """How bases go with codes, learnt from the training photographs: base = A code + b + noise.

    Attributes:
        matrix: (VARYING, CODE_SIZE).
        offset: (VARYING,).
        spread: (VARYING, VARYING) lower triangular; times standard normal noise.
    """

    matrix: Tensor
    offset: Tensor
    spread: Tensor


@dataclass(frozen=True)
class Prior:
    """The space of materials.

    Attributes:
        encoder: photograph to code.
        decoder: code and noise to maps, in units of the base.
        alignment: photograph to tilt.
        habits: for drawing from nothing.
        about: how it was trained; JSON.
    """

    encoder: Encoder
    decoder: Decoder
    alignment: Alignment
    habits: Habits
    about: Mapping[str, Any] = field(default_factory=dict)

    def tilt(self, photo: Photo) -> tuple[float, float]:
        """(tilt_x, tilt_y) of a photograph in radians."""
        with torch.inference_mode():
            shown = picture(photo, WIDTH)[None]
            found = self.alignment(shown, torch.tensor([photo.fov]))[0].tolist()
        return found[0], found[1]

    def code(self, photo: Photo, coarse: CoarseFit, plane: Plane) -> Tensor:
        """(CODE_SIZE,) mean code of a photograph.

        Args:
            photo: the photograph.
            coarse: its coarse fit.
            plane: the photograph at the detail of the capture.
        """
        with torch.no_grad():
            shown = picture(photo, self.encoder.config.width)[None]
            contrast = log_contrast(plane.linear, plane.valid)
            told = numbers(coarse, contrast, plane.size[0])[None]
            seen = texture(describe_windows(plane.linear, plane.valid))[None]
            mean, _ = self.encoder(shown, told, seen)
        return mean[0]

    def start(self, photo: Photo, coarse: CoarseFit, plane: Plane) -> tuple[Decoder, Tensor]:
        """Decoder and code from which a capture starts; arguments as for code().

        The decoder speaks raw outputs itself: the base is folded into its head.
        """
        contrast = log_contrast(plane.linear, plane.valid)
        return fold(self.decoder, base_of(coarse, contrast)), self.code(photo, coarse, plane)

    def draw(self, seed: int) -> Material:
        """A material out of nothing: a standard normal code, and a base that goes with it."""
        generator = torch.Generator().manual_seed(seed)
        code = torch.randn(CODE_SIZE, generator=generator)
        habits = self.habits
        noise = torch.randn(len(habits.offset), generator=generator)
        varying = habits.matrix @ code + habits.offset + habits.spread @ noise
        return self.material(f"drawn_{seed}", base_from(varying), code, {"drawn": seed})

    def material(
        self, name: str, base: Base, code: Tensor, provenance: Mapping[str, Any]
    ) -> Material:
        """A frozen material of a code and a base."""
        decoder = fold(self.decoder, base)
        return Material(
            name=name,
            decoder=decoder.eval().requires_grad_(False),
            code=code,
            moments=tuple(freeze(decoder, code, ())),
            waves=(),
            texel_size=2.0 / _DETAIL,
            setup=FlashSetup(intensity=(math.pi * 4.0,) * 3),
            provenance=provenance,
        )

    def save(self, path: Path) -> None:
        """Write the file, in half precision; whole or not at all."""
        tensors = {
            f"{part}.{name}": tensor.half()
            for part, module in self._modules().items()
            for name, tensor in module.state_dict().items()
        }
        for name, tensor in vars(self.habits).items():
            tensors[f"habits.{name}"] = tensor.float()
        about = {
            "format": FORMAT,
            "version": VERSION,
            "encoder": asdict(self.encoder.config),
            "decoder": asdict(self.decoder.config),
            "about": dict(self.about),
        }
        write_tensors(path, tensors, {"matcap": json.dumps(about)})

    def _modules(self) -> dict[str, nn.Module]:
        return {"encoder": self.encoder, "decoder": self.decoder, "alignment": self.alignment}


def load_prior(path: Path | None = None) -> Prior:
    """Read a prior; None reads the one that comes with matcap.

    Raises:
        MatcapError: missing, no prior, of another version, or damaged; names the tensor.
    """
    path = SHIPPED if path is None else path
    if not path.is_file():
        what = "this is a folder" if path.is_dir() else "there is no such prior"
        raise MatcapError(what, where=str(path), remedy=_REMEDY)
    try:
        with safe_open(path, framework="pt") as file:
            about = _about(file.metadata(), path)
            stored = StoredTensors(file, path, _REMEDY)
            encoder = Encoder(_encoder_config(about["encoder"]))
            prior = Prior(
                encoder=encoder,
                decoder=empty_decoder(decoder_config(about["decoder"])),
                alignment=Alignment(),
                habits=Habits(
                    *(
                        stored.tensor(f"habits.{name}", shape)
                        for name, shape in (
                            ("matrix", (VARYING, CODE_SIZE)),
                            ("offset", (VARYING,)),
                            ("spread", (VARYING, VARYING)),
                        )
                    )
                ),
                about=about["about"],
            )
            for part, module in prior._modules().items():
                module.load_state_dict(
                    {
                        name: stored.tensor(f"{part}.{name}", tuple(value.shape))
                        for name, value in module.state_dict().items()
                    },
                    assign=True,
                )
                module.eval().requires_grad_(False)
            return prior
    except (SafetensorError, OSError) as error:
        raise MatcapError(
            f"this is not a prior, or it is damaged ({error})", where=str(path), remedy=_REMEDY
        ) from error
    except DAMAGED as error:
        raise MatcapError(
            f"the prior's description is damaged ({error})", where=str(path), remedy=_REMEDY
        ) from error


def _about(metadata: Mapping[str, str] | None, path: Path) -> dict[str, Any]:
    if not metadata or "matcap" not in metadata:
        raise MatcapError(
            "this safetensors file is not a matcap prior", where=str(path), remedy=_REMEDY
        )
    about: dict[str, Any] = json.loads(metadata["matcap"])
    if about["format"] != FORMAT:
        raise MatcapError(
            f"this holds a {about['format']}, not a prior", where=str(path), remedy=_REMEDY
        )
    if about["version"] != VERSION:
        raise MatcapError(
            f"this prior is of version {about['version']}; this matcap reads {VERSION}",
            where=str(path),
            remedy=_REMEDY,
        )
    return about


def _encoder_config(stated: Mapping[str, Any]) -> EncoderConfig:
    config = EncoderConfig(backbone=str(stated["backbone"]), width=int(stated["width"]))
    if config.backbone not in BACKBONES or not 32 <= config.width <= 2048:
        raise ValueError(f"encoder {config}")
    return config
