"""Augmented crops of real map sets: cut, scaled, rotated, mirrored, recoloured.

Ranges are those of real materials, so that a few dozen sets cover many: the same bricks paler,
wetter, further away, with half their relief.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from matcap.brdf.maps import DIFFUSE, HEIGHT, SPECULAR, SURFACE, MapSet
from matcap_lab.inverse.packed import LEVELS, PackedSet
from matcap_lab.simulate.materials.draws import Draws
from matcap_lab.simulate.materials.kinds.metal import anodised_f0, metal_colour

_SCALES = (0.3, 2.0)  # texels of the picture to one of the set
_STRENGTHS = (0.5, 2.0)  # of relief
_STEEP = 0.9  # root-mean-square slope that relief is not strengthened beyond
_LEVELLED = 1.0 / 3.0  # share of pieces rotated by any angle, not by quarter turns
_MARGIN = 3  # texels read around the crop, for cubic interpolation
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
    first = _piece(sets[int(rng.integers(len(sets)))], rng, width, height)
    if rng.random() < _MASKED:
        first = masked(first, _piece(sets[int(rng.integers(len(sets)))], rng, width, height), rng)
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


def _piece(packed: PackedSet, rng: np.random.Generator, width: int, height: int) -> Picture:
    """(9, H, W): metal; diffuse, F0, roughness, height in texels."""
    scale = math.exp(rng.uniform(math.log(_SCALES[0]), math.log(_SCALES[1])))
    level = min(int(math.log2(1.0 / scale)), LEVELS - 1) if scale < 1.0 else 0
    piece = cut(packed, level, scale * 2**level, rng, width, height)
    metal, maps = piece[_METAL], piece[_MAPS]
    maps[SURFACE] = coloured(maps[SURFACE], metal, rng)
    # A stream of its own: the other draws do not depend on it.
    maps[SPECULAR] = coloured_metal(maps[SPECULAR], metal, rng.spawn(1)[0])
    slopes = float(np.square(np.diff(piece[HEIGHT], axis=-2)).mean() * 2.0) ** 0.5
    strength = math.exp(rng.uniform(*np.log(_STRENGTHS)))
    piece[HEIGHT] *= min(strength, max(1.0, _STEEP / max(slopes, 1e-6)))
    return piece


def cut(
    packed: PackedSet,
    level: int,
    scale: float,
    rng: np.random.Generator,
    width: int,
    height: int,
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
    matrix[:, 2] = _MARGIN - low + rng.random(2)
    columns, rows = (math.ceil(high[i] - low[i]) + 2 * _MARGIN + 1 for i in (0, 1))
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
    np.clip(maps[SURFACE], 1e-3, 1.0, out=maps[SURFACE])
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
