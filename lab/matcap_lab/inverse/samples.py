"""Endless simulated photographs with their true maps, for the inverse network.

A sample is a pure function of its number, so that training resumes exactly. Each realisation of a
material is photographed several times, since making it takes longer than rendering it.
Random: the material, its scale, field of view, flash offset, tilt, exposure, noise, tone curve, and
a coarse fit with the errors of real coarse fits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor

from matcap.brdf.maps import MapSet
from matcap.brdf.parameters import SurfaceParameters
from matcap.capture.exemplar.network.inputs import network_inputs
from matcap.flash.geometry import FlashSetup, plane_points
from matcap.flash.light import FlashLight
from matcap.flash.render import Uniform, render_flash, uniform_radiance
from matcap_lab.inverse.packed import PackedSet
from matcap_lab.inverse.pieces import coloured_metal, real_piece
from matcap_lab.simulate.develop import contrast, drift, exposure, noisy, random_crop, shoulder
from matcap_lab.simulate.materials import realise
from matcap_lab.simulate.materials.kinds import random_kind
from matcap_lab.simulate.materials.varied import random_material
from matcap_lab.simulate.photograph import RealiseAt

# Kinds excluded from training: captures are evaluated on them.
HELD_OUT = ("leather", "granite", "tile")
_NAMED = ("cloth", "rust", "plaster")
_NAMED_SHARE, _KIND_SHARE = 0.05, 0.6
_MARGIN = 2  # texels realised around, so that blur and normals see no border
REAL_SHARE = 0.5  # of photographs, where real materials are at hand
_TURNS, _VISITS = 16, 16  # pieces in use at a time, photographs of each (or of real materials)
_THIN = 4  # stride in texels at which a picture's brightness is sampled
# Logarithm of a coarse fit's F0 over the truth, mean and deviation, measured on the examples:
# albedo explains part of a wide highlight.
_SPECULAR_OFF = (-0.2, 0.4)
_METALLIC = (0.1, 0.35)  # F0 of simulated maps: dielectric below, metal above
_JPEGS = 0.25  # share of pictures that went through a JPEG at the scale they are read at
_ROOM = 64  # texels by which a piece is larger than a picture


@dataclass(frozen=True)
class Sample:
    """A simulated photograph on its plane's grid, and the truth."""

    linear: Tensor
    """(3, H, W) radiance, clipped at 1."""
    valid: Tensor
    """(H, W) bool, not clipped."""
    truth: MapSet
    """float32 maps, F0 by channel; in plane units where the picture spans x in [-1, 1]."""
    metal: Tensor
    """(1, H, W) share that is metal."""
    uniform: Uniform
    """The coarse fit."""
    points: Tensor
    """(3, H, W) plane points."""

    @property
    def inputs(self) -> Tensor:
        """(C, H, W) what the network reads."""
        return network_inputs(self.linear, self.valid, self.uniform, self.points).stacked()

    @property
    def residuals(self) -> SurfaceParameters:
        """Log-parameter residuals, the network's target; F0 is the mean of its channels."""
        grey = replace(self.truth, specular=self.truth.specular.mean(0, keepdim=True))
        return SurfaceParameters.of(grey) - self.uniform.parameters().to(self.points)

    def to(self, device: str) -> Sample:
        """The same sample with its tensors on a device."""
        tensors: dict[str, Any] = {
            name: part.to(device) for name, part in vars(self).items() if isinstance(part, Tensor)
        }
        return replace(self, truth=self.truth.map(lambda m: m.to(device)), **tensors)


def training_material(rng: np.random.Generator) -> RealiseAt:
    """Draw a material for training: any but the held-out ones."""
    which = rng.random()
    if which < _NAMED_SHARE:
        return partial(realise, str(rng.choice(_NAMED)))
    if which < _NAMED_SHARE + _KIND_SHARE:
        return random_kind(rng).realise
    while (material := random_material(rng)).is_held_out:
        pass
    return material.realise


def draw_setup(rng: np.random.Generator) -> FlashSetup:
    """Draw camera and flash: field of view 40 to 90 degrees, flash 1 to 3 cm from the lens."""
    fov = rng.uniform(40.0, 90.0)
    distance = FlashSetup(fov=fov).distance
    radius = distance * rng.uniform(0.01, 0.1)
    around = rng.uniform(0.0, 2.0 * math.pi)
    tilt = np.clip(rng.normal(0.0, math.radians(3.5), 2), -0.26, 0.26)
    return FlashSetup(
        fov=fov,
        offset=(radius * math.cos(around), radius * math.sin(around), 0.0),
        tilt=(float(tilt[0]), float(tilt[1])),
        vignetting=rng.uniform(0.0, 0.4) if rng.random() < 0.5 else 0.0,
    )


def draw_sample(
    number: int,
    width: int,
    height: int,
    material: Callable[[np.random.Generator], RealiseAt] = training_material,
    sets: Sequence[PackedSet] = (),
    real: float = REAL_SHARE,
) -> Sample:
    """The sample of a number from 0 on, `width` x `height` texels.

    A share `real` of the samples is of the real materials `sets`, if there are any; `material`
    draws the simulated ones.
    """
    rng = np.random.default_rng([number, 77])
    pad = 2 * _MARGIN
    # The picture spans x in [-1, 1]: the same slopes at the picture's own scale.
    size = 2.0 / width
    if sets and rng.random() < real:
        cut, metal = real_piece(sets, rng, width + pad, height + pad)
        maps = replace(cut, height=cut.height * size, texel_size=size)
    else:
        turn = number // (_TURNS * _VISITS) * _TURNS + number % _TURNS
        whole, texel = _piece(turn, width, material)
        cut = random_crop(_turned(whole, rng), width + pad, height + pad, rng)
        maps = replace(cut, height=cut.height * (size / texel), texel_size=size)
        factor = math.exp(rng.normal(0.0, 0.35)) * (-1.0 if rng.random() < 0.06 else 1.0)
        maps = replace(maps, height=(maps.height - maps.height.mean()) * factor)
        maps, metal = _with_metal(maps, np.random.default_rng([number, 79]))
    setup = draw_setup(rng)
    around = plane_points(
        -_MARGIN, -_MARGIN, width + pad, height + pad, (width, height), dtype=torch.float32
    )
    radiance = _blurred(render_flash(maps, setup, around), rng.uniform(0.3, 0.8))
    inside = (..., slice(_MARGIN, _MARGIN + height), slice(_MARGIN, _MARGIN + width))
    radiance, points = radiance[inside], around[inside]
    truth = maps.map(lambda m: m[inside].contiguous())
    linear, gain = _exposed(radiance, rng)
    setup = setup.with_intensity((gain, gain, gain))
    valid = (linear < 0.98).all(0)
    uniform = _fitted(linear, valid, truth, setup, points, rng)
    metal = metal[inside].contiguous()
    return Sample(linear.contiguous(), valid, truth, metal, uniform, points)


@lru_cache(maxsize=_TURNS)
def _piece(
    index: int, width: int, material: Callable[[np.random.Generator], RealiseAt]
) -> tuple[MapSet, float]:
    """Square maps of the material of an index, and their texel size in plane units."""
    rng = np.random.default_rng([index, 78])
    # Texels as fine as those of a photograph read at 500 to 1600 across.
    texel = 2.0 / math.exp(rng.uniform(math.log(500.0), math.log(1600.0)))
    side = width + _ROOM
    maps = material(rng)(side, side, int(rng.integers(2**31)), texel)
    return maps.map(lambda m: m.float()), texel


def _turned(maps: MapSet, rng: np.random.Generator) -> MapSet:
    """Maps randomly mirrored and rotated by multiples of 90 degrees."""
    quarters, mirrored = int(rng.integers(4)), bool(rng.random() < 0.5)

    def turned(m: Tensor) -> Tensor:
        m = torch.rot90(m, quarters, (-2, -1))
        return torch.flip(m, (-1,)) if mirrored else m

    return maps.map(turned)


def _with_metal(maps: MapSet, rng: np.random.Generator) -> tuple[MapSet, Tensor]:
    """Simulated maps with F0 by channel, and (1, H, W) the share that is metal."""
    least, whole = _METALLIC
    metal = ((maps.specular.mean(0, keepdim=True) - least) / (whole - least)).clamp(0.0, 1.0)
    specular = coloured_metal(maps.specular.expand(3, -1, -1).numpy(), metal.numpy(), rng)
    return replace(maps, specular=torch.from_numpy(specular)), metal


def _blurred(radiance: Tensor, deviation: float) -> Tensor:
    picture = radiance.permute(1, 2, 0).contiguous().numpy()
    return torch.from_numpy(cv2.GaussianBlur(picture, (0, 0), deviation)).permute(2, 0, 1)


def _exposed(radiance: Tensor, rng: np.random.Generator) -> tuple[Tensor, float]:
    """The picture after exposure, noise, tone curve and clipping; and the exposure's gain."""
    gain = exposure(radiance, rng)
    linear = radiance * gain
    if rng.random() < 0.4:  # a developed picture: contrast of its own, falloff not quite undone
        linear = contrast(linear, rng.uniform(0.8, 1.25))
        linear = linear * drift(linear.shape[-2], linear.shape[-1], rng, 0.05, 0.02)
        linear = shoulder(linear, rng.uniform(0.0, 0.5))
    linear = noisy(linear, rng.uniform(0.0, 1.0) ** 2, rng)
    if rng.random() < _JPEGS:
        linear = _compressed(linear, int(rng.integers(70, 97)))
    return linear, gain


def _compressed(linear: Tensor, quality: int) -> Tensor:
    """The linear picture (3, H, W) after JPEG compression; clipped pixels stay at 1."""
    coded = linear.clamp_min(0.0).pow(1.0 / 2.2).mul(255.0).add(0.5).to(torch.uint8)
    picture = np.ascontiguousarray(coded.flip(0).permute(1, 2, 0).numpy())
    _, written = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    back = torch.from_numpy(cv2.imdecode(written, cv2.IMREAD_COLOR)).permute(2, 0, 1).flip(0)
    return torch.where(linear >= 0.98, linear, (back.float() / 255.0).pow(2.2))


def _fitted(
    linear: Tensor,
    valid: Tensor,
    truth: MapSet,
    setup: FlashSetup,
    points: Tensor,
    rng: np.random.Generator,
) -> Uniform:
    """A coarse fit drawn near the truth, which reproduces the picture's brightness."""
    slopes = truth.normal[:2].square().sum(0).mean()
    # The highlight is as wide as that of the texels of highest F0: of bare metal between rust.
    specular = truth.specular.mean(0, keepdim=True)
    mirrored = (specular * truth.roughness.square()).mean() / specular.mean()
    alpha = (mirrored.square() + 0.5 * slopes).clamp(1e-4, 0.9).sqrt()
    roughness = float(alpha.sqrt())
    logit = math.log(roughness / (1.0 - roughness)) + rng.normal(0.0, 0.35)
    shift = rng.normal(0.0, 0.015, 2)
    lean = rng.normal(0.0, 0.01, 2)
    near = replace(
        setup,
        offset=(setup.offset[0] + shift[0], setup.offset[1] + shift[1], 0.0),
        tilt=(setup.tilt[0] + lean[0], setup.tilt[1] + lean[1]),
        vignetting=max(0.0, setup.vignetting + rng.normal(0.0, 0.05)),
    )
    f0 = float(specular.mean()) * math.exp(rng.normal(*_SPECULAR_OFF))
    mean = truth.diffuse.mean((1, 2)).tolist()
    uniform = Uniform(
        diffuse=(mean[0], mean[1], mean[2]),
        specular=min(f0, 0.95),
        roughness=1.0 / (1.0 + math.exp(-logit)),
        setup=near,
    )
    # Diffuse albedo explains the rest of the picture's colour, within limits.
    thin = (..., slice(None, None, _THIN), slice(None, None, _THIN))
    seen = valid[thin] if int(valid[thin].sum()) > 64 else torch.ones_like(valid[thin])
    light = FlashLight.of(uniform.setup, points[thin])
    for _ in range(2):
        radiance, diffuse = uniform_radiance(uniform, light)
        over = (linear[thin] - (radiance - diffuse))[:, seen].median(1).values
        under = diffuse[:, seen].median(1).values
        gain = (over / under).clamp(0.5, 2.0).tolist()
        red, green, blue = (min(v * g, 0.95) for v, g in zip(uniform.diffuse, gain, strict=True))
        uniform = replace(uniform, diffuse=(red, green, blue))
    return uniform
