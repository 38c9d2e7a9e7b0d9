"""Photographs that go wrong: what `sweep.py` and lab/tests/stability capture.

Each is made from the flash picture of a simple bumpy material, as an array in linear light.
"""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from matcap.brdf.maps import MapSet
from matcap.flash.geometry import FlashSetup
from matcap.flash.light import render_rectified

Pixels = NDArray[np.float32]
# (width, height, seed) to a picture (height, width, 3).
Hard = Callable[[int, int, int], Pixels]

FOV = 65.0  # a phone's
GOLD = (0.95, 0.75, 0.35)  # F0 by channel


def textured(
    width: int,
    height: int,
    seed: int,
    *,
    diffuse: float = 0.3,
    specular: float | tuple[float, float, float] = 0.04,
    roughness: float = 0.4,
    offset: tuple[float, float, float] = (0.1, 0.05, 0.0),
    tilt: tuple[float, float] = (0.0, 0.0),
) -> Pixels:
    """The flash picture of blotches and bumps of about five pixels; its brightest are 0.9."""
    f0 = torch.tensor(specular).reshape(-1, 1, 1)
    generator = torch.Generator().manual_seed(seed)

    def blotches(channels: int) -> torch.Tensor:
        fine = torch.randn(1, channels, height + 8, width + 8, generator=generator)
        smooth = torch.nn.functional.avg_pool2d(fine, 5, stride=1)
        return smooth[0, :, 2 : 2 + height, 2 : 2 + width] * 5.0

    albedo = diffuse * torch.exp(0.15 * blotches(3))
    texel = 2.0 / width
    maps = MapSet(
        diffuse=albedo.clamp(0.0, 1.0),
        specular=(f0 * torch.exp(0.1 * blotches(1))).clamp(0.0, 1.0),
        roughness=(roughness * torch.exp(0.1 * blotches(1))).clamp(0.0, 1.0),
        height=0.2 * texel * blotches(1),
        texel_size=texel,
    )
    picture = render_rectified(maps, FlashSetup(fov=FOV, offset=offset, tilt=tilt))
    pixels = picture.permute(1, 2, 0).numpy()
    return np.asarray(pixels * (0.9 / float(np.quantile(pixels, 0.999))), np.float32)


def _constant(value: float) -> Hard:
    return lambda width, height, _seed: np.full((height, width, 3), value, np.float32)


def _one_pixel(value: float) -> Hard:
    def picture(width: int, height: int, seed: int) -> Pixels:
        pixels = textured(width, height, seed)
        rng = np.random.default_rng(seed)
        pixels[rng.integers(height), rng.integers(width)] = value
        return pixels

    return picture


def _gain(gain: float) -> Hard:
    return lambda width, height, seed: np.asarray(gain * textured(width, height, seed), np.float32)


def _noise(width: int, height: int, seed: int) -> Pixels:
    return np.random.default_rng(seed).random((height, width, 3)).astype(np.float32)


def _extreme_iso(width: int, height: int, seed: int) -> Pixels:
    pixels = textured(width, height, seed)
    noise = np.random.default_rng(seed).standard_normal(pixels.shape)
    return np.clip(pixels + 0.3 * noise, 0.0, 1.0).astype(np.float32)


def _checkerboard(width: int, height: int, _seed: int) -> Pixels:
    rows, columns = np.indices((height, width))
    board = np.where((rows + columns) % 2, 0.8, 0.1)
    return np.repeat(board[..., None], 3, axis=2).astype(np.float32)


def _stripes(width: int, height: int, _seed: int) -> Pixels:
    wave = 0.5 + 0.4 * np.sin(2.0 * math.pi * np.arange(width) / 12.0)
    return np.broadcast_to(wave[None, :, None], (height, width, 3)).astype(np.float32)


def _one_channel(width: int, height: int, seed: int) -> Pixels:
    pixels = textured(width, height, seed)
    pixels[..., 1:] = 0.0
    return pixels


def _left_half(value: float) -> Hard:
    def picture(width: int, height: int, seed: int) -> Pixels:
        pixels = textured(width, height, seed)
        pixels[:, : width // 2] = value
        return pixels

    return picture


def _one_dot(width: int, height: int, seed: int) -> Pixels:
    pixels = np.zeros((height, width, 3), np.float32)
    rng = np.random.default_rng(seed)
    pixels[rng.integers(height), rng.integers(width)] = 1.0
    return pixels


def _overexposed(width: int, height: int, seed: int) -> Pixels:
    return np.minimum(3.0 * textured(width, height, seed), 1.0).astype(np.float32)


def _half_metal(width: int, height: int, seed: int) -> Pixels:
    pixels = textured(width, height, seed, specular=0.04)
    metal = textured(width, height, seed + 1, diffuse=1e-3, specular=GOLD, roughness=0.3)
    pixels[:, width // 2 :] = metal[:, width // 2 :]
    return pixels


def _made(**material: Any) -> Hard:
    return lambda width, height, seed: textured(width, height, seed, **material)


# What each is called in the table of docs/notes/stability.md.
HARD_PHOTOGRAPHS: Mapping[str, Hard] = MappingProxyType(
    {
        "an ordinary one": textured,
        "black": _constant(0.0),
        "nearly black": _constant(2e-3),
        "white": _constant(1.0),
        "grey": _constant(0.2),
        "overexposed by 1.6 stops": _overexposed,
        "left half clipped": _left_half(1.0),
        "left half black": _left_half(0.0),
        "red alone": _one_channel,
        "one hot pixel": _one_pixel(1.0),
        "one white dot on black": _one_dot,
        "one pixel of 1e30": _one_pixel(1e30),
        "one NaN": _one_pixel(math.nan),
        "one infinity": _one_pixel(math.inf),
        "one negative pixel": _one_pixel(-5.0),
        "noise alone": _noise,
        "extreme ISO noise": _extreme_iso,
        "checkerboard of pixels": _checkerboard,
        "stripes": _stripes,
        "64 x 64": lambda _width, _height, seed: textured(64, 64, seed),
        "a strip": lambda width, _height, seed: textured(8 * width, 64, seed),
        "gain 1e-6": _gain(1e-6),
        "gain 1e-2": _gain(1e-2),
        "gain 1e6": _gain(1e6),
        "no hot spot": _made(specular=0.0, offset=(0.0, 0.0, 3.0)),
        "hot spot at the edge": _made(offset=(1.9, 0.0, 0.0), roughness=0.2),
        "mirror": _made(diffuse=1e-3, specular=0.95, roughness=0.02),
        "gold": _made(diffuse=1e-3, specular=GOLD, roughness=0.3),
        "coloured mirror": _made(diffuse=1e-3, specular=GOLD, roughness=0.02),
        "gloss in red alone": _made(diffuse=0.0, specular=(0.9, 0.0, 0.0), roughness=0.2),
        "coloured gloss on white": _made(diffuse=0.8, specular=(0.0, 0.2, 0.9), roughness=0.2),
        "half of it gold": _half_metal,
        "perfect diffuser": _made(diffuse=0.9, specular=0.0, roughness=1.0),
        "veiled by a wide lobe": _made(diffuse=0.02, roughness=0.7),
        "black albedo": _made(diffuse=0.0, specular=0.04),
        "tilted by 35 degrees": _made(tilt=(0.6, 0.0)),
        "tilted by 50 degrees twice": _made(tilt=(0.6, -0.6)),
    }
)
