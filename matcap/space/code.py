"""The latent vector of a captured material, computed from its exemplar by the prior's encoder.

The exemplar rendered under the photograph's own flash reproduces the photograph, which the prior's
encoder reads. So a capture need not wait for its code, and a material's file
need not hold it.
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
from matcap.flash.coarse import CoarseFit
from matcap.flash.plane import Plane, plane_of
from matcap.flash.render import render_rectified
from matcap.space.freeze import freeze
from matcap.space.prior.store import Prior, load_prior
from matcap.space.tuned import TunedDecoder
from matcap.statistics.lattice import find_lattice


@dataclass(frozen=True)
class _Seen:
    """The piece under the photograph's flash."""

    pixels: NDArray[np.float32]
    coarse: CoarseFit
    plane: Plane


def code_of(material: Material) -> Tensor:
    """(CODE_SIZE,) a material's code: its decoder's, or what the encoder reads of its piece.

    Raises:
        MatcapError: it has neither, or does not say how it was photographed.
    """
    tuned = material.part(TunedDecoder)
    if tuned is not None:
        return tuned.code
    seen = _seen(material)
    return load_prior().code(seen.pixels, seen.coarse, seen.plane)


def tuned_of(material: Material, prior: Prior | None = None) -> TunedDecoder:
    """A material's own decoder, or the prior's at its code, untuned.

    Args:
        material: to be shown by a network.
        prior: by default the one that comes with matcap.

    Raises:
        MatcapError: as code_of.
    """
    tuned = material.part(TunedDecoder)
    if tuned is not None:
        return tuned
    seen = _seen(material)
    decoder, code = (prior or load_prior()).start(seen.pixels, seen.coarse, seen.plane)
    waves = find_lattice(seen.plane.encoded(), seen.plane.valid).waves
    moments = tuple(freeze(decoder, code, waves))
    decoder = decoder.eval().requires_grad_(False)
    return TunedDecoder(decoder, code, moments, waves, material.texel_size)


def _seen(material: Material) -> _Seen:
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
    if material.setup.turned:  # networks know photographs lying
        maps = maps.turned(1)
    with torch.inference_mode():
        linear = render_rectified(maps, coarse.setup).clamp(0.0, 1.0)
    plane = plane_of(linear.clone(), (linear < 1.0).all(0))
    return _Seen(linear.permute(1, 2, 0).contiguous().numpy(), coarse, plane)


def _unplaced(material: Material) -> MatcapError:
    return MatcapError(
        "this material does not say where it lies among others",
        where=material.name,
        remedy="capture its photograph again",
    )
