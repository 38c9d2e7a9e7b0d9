"""The latent vector of a captured material, computed from its exemplar by the prior's encoder.

The encoder's input is a photograph. Rendering the exemplar under the photograph's flash setup gives
an equivalent one, so that captures neither compute nor store the latent vector.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.errors import MatcapError
from matcap.field.header import DAMAGED
from matcap.field.material import Material
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.plane import Plane, plane_of
from matcap.flash.render import render_rectified
from matcap.space.freeze import freeze
from matcap.space.prior.store import Prior, load_prior
from matcap.space.tuned import TunedDecoder
from matcap.statistics.lattice import find_lattice


@dataclass(frozen=True)
class _Rerendered:
    """An exemplar rendered under its photograph's flash, in place of the photograph."""

    pixels: NDArray[np.float32]
    coarse: CoarseFit
    plane: Plane


def code_of(material: Material) -> Tensor:
    """(CODE_SIZE,) latent vector: that of the material's decoder, else the encoder's.

    Raises:
        MatcapError: the material has neither decoder nor exemplar, or its provenance has no
            coarse fit.
    """
    tuned = material.part(TunedDecoder)
    if tuned is not None:
        return tuned.code
    photographed = _rerendered(material)
    return load_prior().code(photographed.pixels, photographed.coarse, photographed.plane)


def tuned_of(material: Material, prior: Prior | None = None) -> TunedDecoder:
    """A material's own decoder, or the prior's decoder, not fine-tuned, at its latent vector.

    Args:
        material: with a decoder or an exemplar.
        prior: None is the one shipped with matcap.

    Raises:
        MatcapError: as code_of.
    """
    tuned = material.part(TunedDecoder)
    if tuned is not None:
        return tuned
    seen = _rerendered(material)
    decoder, code = (prior or load_prior()).start(seen.pixels, seen.coarse, seen.plane)
    waves = find_lattice(seen.plane.encoded(), seen.plane.valid).waves
    moments = tuple(freeze(decoder, code, waves))
    decoder = decoder.eval().requires_grad_(False)
    return TunedDecoder(decoder, code, moments, waves, material.texel_size)


def _rerendered(material: Material) -> _Rerendered:
    maps = next((m for m in (g.piece() for g in material.generators.values()) if m), None)
    try:
        stored = material.provenance["coarse"]
        red, green, blue = (float(v) for v in stored["diffuse"])
        coarse = CoarseFit(
            (red, green, blue),
            float(stored["specular"]),
            float(stored["roughness"]),
            replace(material.setup, turned=False),
            float(stored["residual"]),
        )
    except DAMAGED as error:
        raise _unplaced(material) from error
    if maps is None:
        raise _unplaced(material)
    if material.setup.turned:  # the networks expect landscape orientation
        maps = maps.turned(1)
    with torch.inference_mode():
        linear = render_rectified(maps, coarse.setup).clamp(0.0, 1.0)
    plane = plane_of(linear.clone(), (linear < 1.0).all(0))
    return _Rerendered(linear.permute(1, 2, 0).contiguous().numpy(), coarse, plane)


def _unplaced(material: Material) -> MatcapError:
    return MatcapError(
        "this material has no latent vector",
        where=material.name,
        remedy="capture its photograph again",
    )
