"""Interpolation of two materials: latent vectors and decoder weights, then freezing.

Linear interpolation of latent vector, weights, lattice, texel size and flash setup
[henzler2021, sec. 4.7]. A material without a decoder of its own is represented by its latent vector
and the prior's decoder. Shares 0 and 1 return the given materials unchanged.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from matcap.errors import MatcapError, UsageError
from matcap.field.material import Material
from matcap.flash.geometry import FlashSetup
from matcap.flash.render import render_rectified
from matcap.space.code import tuned_of
from matcap.space.decoder import Decoder, with_cells
from matcap.space.freeze import freeze
from matcap.space.tuned import TunedDecoder
from matcap.statistics.lattice import Wave


def blend(first: Material, second: Material, share: float) -> Material:
    """Interpolate two materials; share 0 is the first, 1 the second.

    Raises:
        UsageError: a share outside [0, 1].
        MatcapError: decoders of different configurations, or a material without a latent vector
            (code.code_of).
    """
    if not 0.0 <= share <= 1.0:
        raise UsageError(f"the share {share:g} is not between 0 and 1", where="-t")
    if share in (0.0, 1.0):
        return second if share else first
    ends = tuned_of(first), tuned_of(second)
    shapes = {replace(end.decoder.config, cells=0) for end in ends}
    if len(shapes) > 1:
        raise MatcapError(
            "the decoders have different shapes",
            where=f"{first.name} and {second.name}",
            remedy="capture both with the same matcap and prior",
        )
    one, other = _of_one_shape(ends[0].decoder, ends[1].decoder)
    decoder = copy.deepcopy(one)
    towards = other.state_dict()
    with torch.no_grad():
        for name, weight in decoder.state_dict().items():
            weight.lerp_(towards[name], share)
    code = torch.lerp(ends[0].code, ends[1].code, share)
    waves = blend_waves(ends[0].waves, ends[1].waves, share)
    tuned = TunedDecoder(
        decoder=decoder.eval().requires_grad_(False),
        code=code,
        moments=tuple(freeze(decoder, code, waves)),
        waves=waves,
        texel_size=_between(first.texel_size, second.texel_size, share),
    )
    return tuned.material(
        f"{first.name}_{second.name}_{share:g}",
        _blend_setups(first.setup, second.setup, share),
        {"blend": [first.name, second.name], "share": share},
    )


def _of_one_shape(first: Decoder, second: Decoder) -> tuple[Decoder, Decoder]:
    """Give a decoder without cell channels the other's weights for them.

    It has no lattice, so that its cell channels are zero and the weights have no effect.
    """
    if first.config.cells == second.config.cells:
        return first, second
    if first.config.cells:
        return first, with_cells(second, first)
    return with_cells(first, second), second


def blend_waves(
    first: tuple[Wave, ...], second: tuple[Wave, ...], share: float
) -> tuple[Wave, ...]:
    """Interpolate two lattices; of lattices with different numbers of waves, take the nearer."""
    if len(first) != len(second):
        return second if share > 0.5 else first
    return tuple(
        # A frequency vector and its negative are the same wave: interpolate to the nearer one.
        Wave(_between(a.fx, side * b.fx, share), _between(a.fy, side * b.fy, share))
        for a, b in zip(first, second, strict=True)
        for side in (1.0 if a.fx * b.fx + a.fy * b.fy >= 0 else -1.0,)
    )


def strip(materials: Sequence[Material], size: int = 256, seed: int = 0) -> NDArray[np.float32]:
    """(size, size * N, 3) linear image: each material rendered under its own flash, in a row."""
    pictures = []
    for material in materials:
        maps = material.maps(size, size, seed=seed)
        with torch.inference_mode():
            picture = render_rectified(maps, material.setup)
        pictures.append(picture.permute(1, 2, 0).numpy())
    return np.concatenate(pictures, axis=1)


def _blend_setups(first: FlashSetup, second: FlashSetup, share: float) -> FlashSetup:
    def mix(a: tuple[float, ...], b: tuple[float, ...]) -> list[float]:
        return [_between(x, y, share) for x, y in zip(a, b, strict=True)]

    x, y, z = mix(first.offset, second.offset)
    red, green, blue = mix(first.intensity, second.intensity)
    tilt_x, tilt_y = mix(first.tilt, second.tilt)
    return FlashSetup(
        fov=_between(first.fov, second.fov, share),
        offset=(x, y, z),
        tilt=(tilt_x, tilt_y),
        intensity=(red, green, blue),
        vignetting=_between(first.vignetting, second.vignetting, share),
        vignetting_quartic=_between(first.vignetting_quartic, second.vignetting_quartic, share),
    )


def _between(first: float, second: float, share: float) -> float:
    return first + share * (second - first)
