"""Interpolation of two materials.

Where both have exemplars, these are interpolated (example/interpolate.py). Between two decoders the
latent vector, weights, lattice, texel size and flash setup are interpolated linearly [henzler2021,
sec. 4.7], the exemplars that they draw from as above, and statistics frozen again; of a decoder and
an exemplar, the decoder's is a rectangle of its field. Shares 0 and 1 return the given materials.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from matcap.errors import MatcapError, UsageError
from matcap.example.example import Example, coarsened
from matcap.example.exemplar import Exemplar
from matcap.example.interpolate import interpolated, pattern_of
from matcap.example.variety import with_chosen_variety
from matcap.field.material import Material
from matcap.flash.geometry import FlashSetup
from matcap.space.decoder import Decoder, with_cells, with_drawing
from matcap.space.freeze import Drawing, freeze
from matcap.space.prior.store import flash_picture
from matcap.space.tuned import TunedDecoder
from matcap.statistics.lattice import Wave, find_lattice

_DRAWN = (512, 384)  # texels of a decoder's field that are its exemplar


def blend(first: Material, second: Material, share: float) -> Material:
    """Interpolate two materials; share 0 is the first, 1 the second.

    Raises:
        UsageError: a share outside [0, 1].
        MatcapError: two decoders of different configurations.
    """
    if not 0.0 <= share <= 1.0:
        raise UsageError(f"the share {share:g} is not between 0 and 1", where="-t")
    if share in (0.0, 1.0):
        return second if share else first
    check_blendable(first, second)
    name = f"{first.name}_{second.name}_{share:g}"
    setup = _blend_setups(first.setup, second.setup, share)
    provenance = {"blend": [first.name, second.name], "share": share}
    decoders = _decoders(first, second)
    if decoders is not None:
        return _blend_decoders(*decoders, share).material(name, setup, provenance)
    exemplar = interpolated(_exemplar_of(first), _exemplar_of(second), share)
    example = _indexed(exemplar)
    return Material(name, {"example": example}, exemplar.texel_size, setup, provenance)


def check_blendable(first: Material, second: Material) -> None:
    """Raise what blend() would raise.

    Raises:
        MatcapError: two decoders of different configurations.
    """
    decoders = _decoders(first, second) or ()
    if len({replace(one.decoder.config, cells=0, drawing=0) for one in decoders}) > 1:
        raise MatcapError.at(
            f"{first.name} and {second.name}",
            "the decoders have different shapes",
            "capture both with the same matcap and prior",
        )


def loses_patterns(first: Material, second: Material) -> bool:
    """Whether their blends have no pattern: those of two decoders of which neither draws."""
    decoders = _decoders(first, second)
    return decoders is not None and all(one.drawing is None for one in decoders)


def _decoders(first: Material, second: Material) -> tuple[TunedDecoder, TunedDecoder] | None:
    """The decoders of both, or None where either has an exemplar."""
    one, other = (material.generator for material in (first, second))
    if isinstance(one, TunedDecoder) and isinstance(other, TunedDecoder):
        return one, other
    return None


def _exemplar_of(material: Material) -> Exemplar:
    example = material.part(Example)
    if example is not None:
        return example.exemplar
    maps = material.maps(*_DRAWN)
    return Exemplar.certain(maps.stacked().numpy(), maps.texel_size)


def _indexed(exemplar: Exemplar) -> Example:
    """Index an exemplar, with the lattice of its pattern."""
    pattern = torch.from_numpy(pattern_of(exemplar))
    waves = find_lattice(pattern[None], torch.ones(pattern.shape, dtype=torch.bool)).waves
    return with_chosen_variety(Example.of(exemplar, waves))


def _blend_decoders(first: TunedDecoder, second: TunedDecoder, share: float) -> TunedDecoder:
    one, other = _of_one_shape(first.decoder, second.decoder)
    decoder = copy.deepcopy(one)
    towards = other.state_dict()
    with torch.no_grad():
        for name, weight in decoder.state_dict().items():
            weight.lerp_(towards[name], share)
    code = torch.lerp(first.code, second.code, share)
    waves = blend_waves(first.waves, second.waves, share)
    drawing = _blend_drawings(first.drawing, second.drawing, share)
    texel_size = _between(first.texel_size, second.texel_size, share)
    return TunedDecoder(
        decoder=decoder.eval().requires_grad_(False),
        code=code,
        moments=tuple(freeze(decoder, code, waves, drawing)),
        waves=waves,
        texel_size=texel_size if drawing is None else drawing.texel_size,
        drawing=drawing,
    )


def _blend_drawings(first: Drawing | None, second: Drawing | None, share: float) -> Drawing | None:
    """The drawing of the interpolated exemplar; the only one where the other decoder has none."""
    if first is None or second is None:
        return first or second
    one, other = (_lying(drawing) for drawing in (first, second))
    return Drawing(_indexed(interpolated(one, other, share)))


def _lying(drawing: Drawing) -> Exemplar:
    """A drawing's exemplar at its resolution, in landscape format."""
    exemplar = coarsened(drawing.example.exemplar, drawing.finer.bit_length() - 1)
    for _ in range(3 if drawing.turned else 0):  # by 90 degrees clockwise each
        exemplar = exemplar.turned()
    return exemplar


def _of_one_shape(first: Decoder, second: Decoder) -> tuple[Decoder, Decoder]:
    """Give a decoder the channels that only the other one reads: a drawing's with weights of zero.

    A decoder without cell channels gets the other's weights: it has no lattice, so that its cells
    are zero.
    """
    if first.config.drawing or second.config.drawing:
        first, second = with_drawing(first), with_drawing(second)
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
    pictures = [flash_picture(material, size, seed) for material in materials]
    return torch.cat(pictures, dim=2).permute(1, 2, 0).numpy()


def _blend_setups(first: FlashSetup, second: FlashSetup, share: float) -> FlashSetup:
    """Interpolate two setups; of a portrait and a landscape, only the intensity."""

    def mix(a: tuple[float, ...], b: tuple[float, ...]) -> list[float]:
        return [_between(x, y, share) for x, y in zip(a, b, strict=True)]

    red, green, blue = mix(first.intensity, second.intensity)
    if first.turned != second.turned:
        return (second if share > 0.5 else first).with_intensity((red, green, blue))
    x, y, z = mix(first.offset, second.offset)
    tilt_x, tilt_y = mix(first.tilt, second.tilt)
    across, up = mix(first.vignetting_centre, second.vignetting_centre)
    by_red, by_green, by_blue = mix(first.vignetting_colour, second.vignetting_colour)
    return FlashSetup(
        fov=_between(first.fov, second.fov, share),
        offset=(x, y, z),
        tilt=(tilt_x, tilt_y),
        intensity=(red, green, blue),
        vignetting=_between(first.vignetting, second.vignetting, share),
        vignetting_quartic=_between(first.vignetting_quartic, second.vignetting_quartic, share),
        vignetting_centre=(across, up),
        vignetting_colour=(by_red, by_green, by_blue),
        turned=first.turned,
    )


def _between(first: float, second: float, share: float) -> float:
    return first + share * (second - first)
