"""Material: a captured material and its file, `.matcap`.

One safetensors file of float32 tensors, whose metadata has one entry, `matcap`, which is JSON.
Nothing in it is executed, and every shape is checked against the stated configuration before
anything is read.

Tensors:
    decoder.*: the fine-tuned network; shapes as the configuration says.
    code: (64,), the material's code.
    moments.*.mean: (channels of layer *,), frozen mean of its AdaIN's input.
    moments.*.deviation: (channels of layer *,), frozen deviation of it.

Metadata:
    format: "matcap-material".
    version: 1.
    name: of the photograph.
    decoder: `noise_channels`, `widths` (five), `convolutions` (down, up) and `cells` (channels of
        the noise of cells, 0 or absent for none).
    waves: at most two of `{fx, fy}`, cycles a texel; the plane waves of regular order.
    texel_size: plane units.
    setup: camera and flash: `fov` (degrees), `offset`, `tilt` (radians), `intensity`, `vignetting`.
    provenance: how it was made.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.errors import MatcapError
from matcap.flash.geometry import FlashSetup
from matcap.model.decoder import CODE_SIZE, Decoder, Moments
from matcap.model.field import Field
from matcap.model.freeze import FoldedDecoder, fold
from matcap.model.stored import DAMAGED, StoredTensors, decoder_config, empty_decoder
from matcap.statistics.lattice import Wave

FORMAT = "matcap-material"
VERSION = 1  # of the file
_NAMED = re.compile(r"[^\w .,()+-]+")
_REMEDY = "capture the photograph again, or fetch the file again"


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
    """

    name: str
    decoder: Decoder
    code: Tensor
    moments: tuple[Moments, ...]
    waves: tuple[Wave, ...]
    texel_size: float
    setup: FlashSetup
    provenance: Mapping[str, Any] = field(default_factory=dict)

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
    ) -> MapSet:
        """Maps of a rectangle of the endless field; see model.field.Field.read.

        Args:
            width: in texels.
            height: in texels.
            seed: which realisation.
            x: of the left top texel.
            y: of the left top texel, downwards.
            period: repeat of the field in texels, or None for an endless one.
        """
        return Field(self, seed, period).read(x, y, width, height)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the file: to a temporary name beside it, then renamed.

        Raises:
            MatcapError: the folder cannot be written, or the disk is full.
        """
        path = Path(path)
        tensors = {f"decoder.{k}": v.contiguous() for k, v in self.decoder.state_dict().items()}
        tensors["code"] = self.code.contiguous()
        for index, (mean, deviation) in enumerate(self.moments):
            tensors[f"moments.{index}.mean"] = mean.contiguous()
            tensors[f"moments.{index}.deviation"] = deviation.contiguous()
        about = {
            "format": FORMAT,
            "version": VERSION,
            "name": self.name,
            "decoder": asdict(self.decoder.config),
            "waves": [asdict(wave) for wave in self.waves],
            "texel_size": self.texel_size,
            "setup": asdict(self.setup),
            "provenance": dict(self.provenance),
        }
        temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
        try:
            # As bytes: save_file would give the file to its owner alone, whatever the umask says.
            temporary.write_bytes(save(tensors, metadata={"matcap": json.dumps(about)}))
            os.replace(temporary, path)
        except (OSError, SafetensorError) as error:
            raise MatcapError(
                f"the material cannot be written ({error})",
                where=str(path),
                remedy="choose a folder that can be written and has room",
            ) from error
        finally:
            temporary.unlink(missing_ok=True)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Material:
        """Read a `.matcap` file.

        Raises:
            MatcapError: missing, not a material, of another version, or damaged; names the tensor.
        """
        path = Path(path)
        if not path.is_file():
            what = "this is a folder" if path.is_dir() else "there is no such file"
            raise MatcapError(what, where=str(path), remedy="give a .matcap file")
        try:
            with safe_open(path, framework="pt") as file:
                about = _about(file.metadata(), path)
                stored = StoredTensors(file, path, _REMEDY)
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
                    name=_plain(str(about["name"])),
                    decoder=decoder.eval().requires_grad_(False),
                    code=code,
                    moments=tuple(moments),
                    waves=_waves(about["waves"]),
                    texel_size=_number(about, "texel_size", 1e-9, 1e3),
                    setup=_setup(about["setup"]),
                    provenance=dict(about["provenance"]),
                )
        except (SafetensorError, OSError) as error:
            raise MatcapError(
                f"this is not a material, or it is damaged ({error})",
                where=str(path),
                remedy=_REMEDY,
            ) from error
        except DAMAGED as error:
            raise MatcapError(
                f"the material's description is damaged ({error})",
                where=str(path),
                remedy=_REMEDY,
            ) from error


def _about(metadata: Mapping[str, str] | None, path: Path) -> dict[str, Any]:
    if not metadata or "matcap" not in metadata:
        raise MatcapError(
            "this safetensors file is not a matcap material",
            where=str(path),
            remedy="give a .matcap file written by matcap capture",
        )
    about: dict[str, Any] = json.loads(metadata["matcap"])
    if about["format"] != FORMAT:
        raise MatcapError(
            f"this holds a {about['format']}, not a material",
            where=str(path),
            remedy="give a .matcap file written by matcap capture",
        )
    if about["version"] != VERSION:
        raise MatcapError(
            f"this material is of version {about['version']}; this matcap reads {VERSION}",
            where=str(path),
            remedy="install the matcap that wrote it, or capture the photograph again",
        )
    return about


def _plain(name: str) -> str:
    """The name as one that may be a file's: nothing of it leads to another folder."""
    return _NAMED.sub("_", name)[:100].strip(" .") or "material"


def _waves(stated: list[Mapping[str, Any]]) -> tuple[Wave, ...]:
    return tuple(Wave(_number(w, "fx", -1.0, 1.0), _number(w, "fy", -1.0, 1.0)) for w in stated[:2])


def _setup(stated: Mapping[str, Any]) -> FlashSetup:
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
