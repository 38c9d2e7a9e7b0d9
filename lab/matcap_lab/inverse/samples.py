"""Endless simulated photographs with their true maps, for the inverse network.

A sample is a pure function of its number, so that training resumes exactly. Each realisation of a
material is photographed several times, since making it takes longer than rendering it.
Random: the material, its scale, field of view, flash offset, tilt, exposure, noise, tone curve, and
a coarse fit with the errors of real coarse fits.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.cook_torrance import SurfaceParameters
from matcap.brdf.heights import integrate_periodic
from matcap.brdf.maps import DIFFUSE, HEIGHT, SPECULAR, MapSet
from matcap.capture.exemplar.network.network import network_inputs
from matcap.errors import MatcapError
from matcap.files.tensors import write_tensors
from matcap.flash.geometry import FlashSetup, plane_points
from matcap.flash.light import FlashLight, Uniform, render_flash, uniform_radiance
from matcap_lab.simulate.kinds import random_kind
from matcap_lab.simulate.kinds.metals_and_coats import anodised_f0, metal_colour
from matcap_lab.simulate.named import realise
from matcap_lab.simulate.photograph import (
    RealiseAt,
    contrast,
    drift,
    exposure,
    noisy,
    random_crop,
    shoulder,
)
from matcap_lab.simulate.specimen import read_surface
from matcap_lab.simulate.varied import Draws, random_material
from matcap_lab.train.trainer import read_tensors

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
    radius = FlashSetup(fov=fov).distance * rng.uniform(0.01, 0.1)
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
    roughness = float((mirrored.square() + 0.5 * slopes).clamp(1e-4, 0.9).sqrt().sqrt())
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
        gain = (over / diffuse[:, seen].median(1).values).clamp(0.5, 2.0).tolist()
        red, green, blue = (min(v * g, 0.95) for v, g in zip(uniform.diffuse, gain, strict=True))
        uniform = replace(uniform, diffuse=(red, green, blue))
    return uniform


# Augmented crops of real map sets: cut, scaled, rotated, mirrored, recoloured.
#
# Ranges are those of real materials, so that a few dozen sets cover many: the same bricks paler,
# wetter, further away, with half their relief.

_SCALES = (0.3, 2.0)  # texels of the picture to one of the set
_STRENGTHS = (0.5, 2.0)  # of relief
_STEEP = 0.9  # root-mean-square slope that relief is not strengthened beyond
_LEVELLED = 1.0 / 3.0  # share of pieces rotated by any angle, not by quarter turns
_PIECE_MARGIN = 3  # texels read around the crop, for cubic interpolation
_DARKEST, _PALEST = 0.01, 0.92  # mean albedos of real materials lie within
_METAL = slice(0, 1)  # of what is cut: the share that is metal, before the maps
_MAPS = slice(1, None)
_MASKED = 0.12  # share of pieces of two materials

Picture = NDArray[np.float32]


def real_piece(
    sets: Sequence[PackedSet], rng: np.random.Generator, width: int, height: int
) -> tuple[MapSet, Tensor]:
    """A crop of one of the sets, or two blended by a mask; height and texel size in texels.

    Also (1, height, width) the share that is metal.
    """
    first = _window(sets[int(rng.integers(len(sets)))], rng, width, height)
    if rng.random() < _MASKED:
        first = masked(first, _window(sets[int(rng.integers(len(sets)))], rng, width, height), rng)
    whole = torch.from_numpy(first)
    maps = MapSet.from_stacked(whole[_MAPS], 1.0)
    return replace(maps, height=maps.height - maps.height.mean()), whole[_METAL]


def masked(below: Picture, above: Picture, rng: np.random.Generator) -> Picture:
    """Two crops (9, H, W) blended by a soft or hard random mask, one a little higher."""
    height, width = below.shape[-2:]
    share = cloudy(rng, height, width)
    level = np.quantile(share, rng.uniform(0.25, 0.75))
    softness = math.exp(rng.uniform(math.log(0.01), math.log(0.4)))
    share = np.clip(0.5 + (share - level) / softness, 0.0, 1.0).astype(np.float32)
    mixed = below + (above - below) * share
    mixed[HEIGHT] += share * rng.normal(0.0, 1.5)
    return np.asarray(mixed, np.float32)


def cloudy(rng: np.random.Generator, height: int, width: int) -> Picture:
    """(1, H, W) smooth noise of a few octaves, standard deviation about 1."""
    total = np.zeros((height, width), np.float32)
    cells = int(rng.integers(2, 6))
    for octave in range(3):
        side = cells * 2**octave
        coarse = rng.standard_normal((side, side)).astype(np.float32) * 0.6**octave
        total += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return total[None]


def _window(packed: PackedSet, rng: np.random.Generator, width: int, height: int) -> Picture:
    """(9, H, W): metal; diffuse, F0, roughness, height in texels."""
    scale = math.exp(rng.uniform(math.log(_SCALES[0]), math.log(_SCALES[1])))
    level = min(int(math.log2(1.0 / scale)), LEVELS - 1) if scale < 1.0 else 0
    piece = cut(packed, level, scale * 2**level, rng, width, height)
    metal, maps = piece[_METAL], piece[_MAPS]
    maps[:-1] = coloured(maps[:-1], metal, rng)
    # A stream of its own: the other draws do not depend on it.
    maps[SPECULAR] = coloured_metal(maps[SPECULAR], metal, rng.spawn(1)[0])
    slopes = float(np.square(np.diff(piece[HEIGHT], axis=-2)).mean() * 2.0) ** 0.5
    strength = math.exp(rng.uniform(*np.log(_STRENGTHS)))
    piece[HEIGHT] *= min(strength, max(1.0, _STEEP / max(slopes, 1e-6)))
    return piece


def cut(
    packed: PackedSet, level: int, scale: float, rng: np.random.Generator, width: int, height: int
) -> Picture:
    """(9, height, width) randomly placed, rotated and mirrored crop of a level, periodic.

    Channels: share that is metal, diffuse (3), F0 (3), roughness, height. `scale`: texels of the
    crop to one of the pyramid's level.
    """
    turn = float(rng.integers(4)) * math.pi / 2.0
    if rng.random() < _LEVELLED:
        turn = rng.uniform(0.0, 2.0 * math.pi)
    mirror = -1.0 if rng.random() < 0.5 else 1.0
    cosine, sine = math.cos(turn) / scale, math.sin(turn) / scale
    # From a texel of the crop to one of the set.
    matrix = np.array([[cosine * mirror, -sine, 0.0], [sine * mirror, cosine, 0.0]])
    corners = matrix[:, :2] @ np.array([[0, width, 0, width], [0, 0, height, height]], float)
    low, high = corners.min(1), corners.max(1)
    matrix[:, 2] = _PIECE_MARGIN - low + rng.random(2)
    columns, rows = (math.ceil(high[i] - low[i]) + 2 * _PIECE_MARGIN + 1 for i in (0, 1))
    whole, relief = packed.surface[level], packed.height[level]
    across = (np.arange(columns) + int(rng.integers(whole.shape[-1]))) % whole.shape[-1]
    down = (np.arange(rows) + int(rng.integers(whole.shape[-2]))) % whole.shape[-2]
    here = np.ix_(down, across)
    *surface, metal = (layer[here].astype(np.float32) for layer in whole.numpy())
    layers = [metal, *surface, relief.numpy()[0][here]]
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    warped = [cv2.warpAffine(layer, matrix, (width, height), flags=flags) for layer in layers]
    piece = np.stack(warped).astype(np.float32)
    piece[HEIGHT] *= scale
    maps = piece[_MAPS]
    np.clip(maps[:-1], 1e-3, 1.0, out=maps[:-1])
    np.clip(piece[_METAL], 0.0, 1.0, out=piece[_METAL])
    return piece


def coloured(surface: Picture, metal: Picture, rng: np.random.Generator) -> Picture:
    """(7, H, W) surface with random changes of brightness, hue, F0 and roughness."""
    albedo, specular, roughness = surface[DIFFUSE], surface[3:6], surface[6:]
    mean = albedo.mean((1, 2), keepdims=True)
    gain = math.exp(rng.normal(0.0, 0.35))
    tint = np.exp(rng.normal(0.0, 0.12, (3, 1, 1)))
    if rng.random() < 0.15:  # another hue altogether
        order = rng.permutation(3)
        albedo, mean = albedo[order], mean[order]
    contrast = math.exp(rng.normal(0.0, 0.2))
    level = np.clip(mean * gain * tint, _DARKEST, _PALEST)
    # Bare metal keeps diffuse albedo 0.
    level = np.minimum(level, mean * 10.0)
    albedo = level * (albedo / mean) ** contrast
    shift = rng.normal(0.0, (0.25, 0.3), 2)
    specular = specular * np.exp(shift[0] * (1.0 - metal) + shift[1] * metal)
    logit = np.log(roughness.clip(0.02, 0.98) / (1.0 - roughness.clip(0.02, 0.98)))
    spread = math.exp(rng.normal(0.0, 0.2))
    logit = logit.mean() + (logit - logit.mean()) * spread + rng.normal(0.0, 0.4)
    parts = [
        albedo.clip(1e-3, 0.95), specular.clip(0.015, 0.97), 1.0 / (1.0 + np.exp(-logit)),
    ]  # fmt: skip
    return np.concatenate(parts).astype(np.float32)


# Map sets have few coloured metals: shares of pieces of metal that keep their colour, or get a
# known metal's; the rest are dyed.
_AS_IT_IS, _KNOWN = 0.4, 0.35
_LEAST_F0, _MOST_F0 = 0.015, 0.98
_SOME, _SOME_SHARE = 0.5, 0.01  # a piece with this share of texels more metal than that is coloured


def coloured_metal(specular: Picture, metal: Picture, rng: np.random.Generator) -> Picture:
    """F0 (3, H, W) with its metal, of share (1, H, W), recoloured at random, or unchanged.

    Contrast and variations of colour are preserved.
    """
    which = rng.random()
    if which < _AS_IT_IS or float((metal > _SOME).mean()) < _SOME_SHARE:
        return specular
    draws = Draws(rng.bit_generator)
    colour = metal_colour(draws) if which < _AS_IT_IS + _KNOWN else anodised_f0(draws)
    mean = float((specular * metal).sum() / (3.0 * metal.sum()))
    gain = 1.0 + metal * (colour.astype(np.float32)[:, None, None] / np.float32(mean) - 1.0)
    return np.asarray((specular * gain).clip(_LEAST_F0, _MOST_F0), np.float32)


# Map sets of real materials in one training file: a half-precision pyramid of each.
#
# A set's folder holds `basecolor`, `normal`, `roughness` and, where some of it is metal, `metallic`
# (../data/maps/README.md of the project). Height is integrated from the normals: a height map's
# scale would be unknown. Each level halves the resolution; the slope variance that this removes is
# added to alpha^2.

LEVELS = 3  # full, half, quarter
_ROUGHNESS = slice(6, 7)  # of a surface
# A set is held out where its name's hash leaves this remainder: one that has sets of every kind.
_EVERY, _LEFT_OUT = 5, 1
_STEEPEST = math.tan(math.radians(75.0))  # slope; steeper texels of normal maps are faults
_FORMAT = "matcap-maps"
_VERSION = 3


@dataclass(frozen=True)
class PackedSet:
    """Maps of one material, tileable, level by level."""

    name: str
    """Name of its folder."""
    surface: tuple[Tensor, ...]
    """Level by level (8, H, W) float16: diffuse albedo and F0 (linear, 3 each), roughness, and the
    share that is metal."""
    height: tuple[Tensor, ...]
    """Level by level (1, H, W) float32 in texels of that level, of mean 0."""


def is_held_out(name: str) -> bool:
    """Whether a set is left out of training: a fifth, by its name alone."""
    return zlib.crc32(name.encode()) % _EVERY == _LEFT_OUT


def pack(folder: Path, out: Path) -> int:
    """Write all sets in a folder as one file; returns how many.

    The sides of their maps are multiples of 2^(LEVELS - 1).

    Raises:
        MatcapError: there is none, or one of them cannot be read.
    """
    names = sorted(path.parent.name for path in folder.glob("*/normal.*"))
    if not names:
        raise MatcapError.at(
            folder,
            "there are no map sets in this folder",
            "give a folder of folders with basecolor, normal and roughness",
        )
    tensors: dict[str, Tensor] = {}
    for name in names:
        surface, slopes = read_surface(folder / name)
        steepness = np.sqrt(np.square(slopes).sum(0, keepdims=True))
        slopes = slopes * np.minimum(1.0, _STEEPEST / np.maximum(steepness, 1e-6))
        surface, height = surface.astype(np.float32), integrate_periodic(slopes)
        for level in range(LEVELS):
            if level:
                surface, height = halved(surface, height)
            tensors[f"{name}/{level}/surface"] = torch.from_numpy(surface).half()
            tensors[f"{name}/{level}/height"] = torch.from_numpy(height)
    about = {"format": _FORMAT, "version": str(_VERSION), "names": json.dumps(names)}
    write_tensors(out, tensors, about)
    return len(names)


def halved(surface: Picture, height: Picture) -> tuple[Picture, Picture]:
    """The set at half its resolution; the slope variance removed is added to alpha^2."""
    fine = np.square(_slopes(height)).sum(0, keepdims=True)
    coarse_height = _mean(height) / 2.0
    lost = np.maximum(_mean(fine) - np.square(_slopes(coarse_height)).sum(0, keepdims=True), 0.0)
    # The mean of lobes weighted by F0 has the weighted mean of alpha^2.
    coarse = surface.copy()
    coarse[_ROUGHNESS] **= 4
    coarse = _mean(coarse)
    coarse[_ROUGHNESS] = np.minimum(coarse[_ROUGHNESS] + lost, 1.0) ** 0.25
    return coarse, coarse_height


@cache
def open_pack(path: Path) -> Mapping[str, PackedSet]:
    """All sets of a file by name; read once a process.

    Raises:
        MatcapError: it is no such file.
    """
    remedy = "make it with `matcap-lab inverse pack`"
    metadata, tensors = read_tensors(path, (_FORMAT, _VERSION), "pack of maps", remedy)

    def levels(name: str, what: str) -> tuple[Tensor, ...]:
        return tuple(tensors[f"{name}/{i}/{what}"] for i in range(LEVELS))

    names: list[str] = json.loads(metadata["names"])
    return {n: PackedSet(n, levels(n, "surface"), levels(n, "height")) for n in names}


@cache
def training_sets(path: Path) -> tuple[PackedSet, ...]:
    """The sets of a file for training."""
    return tuple(s for name, s in open_pack(path).items() if not is_held_out(name))


def held_out_sets(path: Path) -> tuple[PackedSet, ...]:
    """The held-out sets of a file."""
    return tuple(s for name, s in open_pack(path).items() if is_held_out(name))


def _slopes(height: Picture) -> Picture:
    """(2, H, W) central differences of a periodic height (1, H, W) in texels."""
    across = (np.roll(height, -1, -1) - np.roll(height, 1, -1)) / 2.0
    down = (np.roll(height, 1, -2) - np.roll(height, -1, -2)) / 2.0
    return np.concatenate([across, down])


def _mean(picture: Picture) -> Picture:
    """Means of 2 x 2 texels of (C, H, W)."""
    channels, height, width = picture.shape
    cells = picture.reshape(channels, height // 2, 2, width // 2, 2)
    return np.asarray(cells.mean((2, 4)), np.float32)
