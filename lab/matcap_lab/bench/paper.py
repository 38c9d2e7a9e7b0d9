"""The paper's own fine-tuning [henzler2021, sec. 4.3 and 4.5], a baseline; slow.

It starts from the prior at the photograph's code. A step decodes new noise for the whole picture,
renders it, and compares crops of rendering and photograph at one random place and scale: L1
differences of the features' Gram matrices, plus 1e-3 times those of their power spectra.

As the paper's published program has it and its text does not: pictures continue by reflection, and
amplitudes stand for power. Different from the paper: crops have VGG's 224 x 224 pixels, as in the
text, not 512 x 384, as in the program; VGG-16 or random filters; the prior is matcap's.
"""

from __future__ import annotations

import copy
from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.capture.result import CaptureResult
from matcap.field.device import computes_bfloat16
from matcap.field.material import Material
from matcap.field.plane import Rectangle
from matcap.files.srgb import srgb_encode_tensor
from matcap.flash.geometry import plane_points
from matcap.flash.render import render_flash
from matcap.space.decoder import ALIGNMENT, DEPTH, maps_from_raw
from matcap.space.freeze import freeze
from matcap.space.patch import Patch
from matcap.space.random_field import random_field
from matcap.space.tuned import TunedDecoder
from matcap.statistics.filterbank import FilterBank, FilterBankConfig, pyramid
from matcap.statistics.gram import gram

STEPS = 1000
RATE, DECAY = 1e-3, 1e-5  # ten times the rate of its training, and its weight decay
SPECTRUM = 1e-3  # lambda
SCALES = (0.1, 8.0)  # picture texels per pixel of a crop
CROP = 224  # pixels

ImageFeatures = Callable[[Tensor], list[Tensor]]  # of sRGB pictures (B, 3, H, W)


def random_features() -> ImageFeatures:
    """Random filters on a pyramid in VGG's place; values from 0 to 255, as VGG-16 reads them."""
    bank = FilterBank(FilterBankConfig(sizes=(3, 5, 9), filters=48))
    return lambda pictures: [bank.features(level) for level in pyramid(255.0 * pictures, 5)]


def finetuned_as_in_paper(
    untuned: CaptureResult, features: ImageFeatures, seed: int, steps: int = STEPS
) -> Material:
    """Fine-tune an untuned capture by the decoder, without a drawing, as the paper does.

    The photograph is in landscape format; features are VGG's or random ones; `seed` is of noise,
    places and scales; `steps` are Adam's.
    """
    start = untuned.material.part(TunedDecoder)
    assert start is not None
    setup = untuned.material.setup
    height, width = (side // ALIGNMENT * ALIGNMENT for side in untuned.rectified.shape[:2])
    pixels = torch.from_numpy(untuned.rectified[:height, :width].copy()).permute(2, 0, 1)[None]
    points = plane_points(0, 0, width, height, untuned.rectified.shape[1::-1], dtype=torch.float32)
    seen = (pixels > 0.0).any(1, keepdim=True)
    decoder = copy.deepcopy(start.decoder).requires_grad_(True)
    optimiser = torch.optim.Adam(decoder.parameters(), RATE, weight_decay=DECAY)
    generator = torch.Generator().manual_seed(seed)
    area, config = Rectangle(0, 0, width, height), decoder.config
    for step in range(steps):
        patch = Patch(seed + step, area, period=(width, height))
        field = random_field(patch, config.noise_channels, (), levels=DEPTH, cells=config.cells)
        with torch.autocast("cpu", torch.bfloat16, enabled=computes_bfloat16()):
            raw = decoder(field, start.code)
        maps = maps_from_raw(raw.float(), start.texel_size, periodic=True)
        rendered = torch.where(seen, render_flash(maps, setup, points[None]), pixels)
        both = srgb_encode_tensor(torch.cat([rendered, pixels]).clamp(1e-4, 1.0))
        loss = _difference(features, crop(both, generator))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    decoder.requires_grad_(False)
    moments = tuple(freeze(decoder, start.code, ()))
    tuned = TunedDecoder(decoder, start.code, moments, (), start.texel_size)
    return tuned.material(untuned.material.name, setup)


def crop(pictures: Tensor, generator: torch.Generator) -> Tensor:
    """(B, 3, CROP, CROP) of pictures (B, 3, H, W), all at one random place and scale."""
    low, high = SCALES
    place_x, place_y, scale = torch.rand(3, generator=generator).tolist()
    scale = low + (high - low) * scale
    if scale > 1.0:  # a Gaussian of 5 texels against aliasing
        kernel = torch.exp(-0.5 * (torch.arange(-2.0, 3.0) * 3.0 / scale).square())
        kernel = (kernel / kernel.sum()).expand(3, 1, 1, 5)
        for weight in (kernel, kernel.transpose(2, 3)):
            sides = (2, 2, 0, 0) if weight is kernel else (0, 0, 2, 2)
            pictures = F.conv2d(F.pad(pictures, sides, "reflect"), weight, groups=3)
    height, width = pictures.shape[-2:]
    along = scale * torch.arange(CROP)
    x = 2.0 * (along + 2.0 * width * place_x) / (width - 1) - 1.0
    y = 2.0 * (along + 2.0 * height * place_y) / (height - 1) - 1.0
    grid = torch.stack([x.expand(CROP, CROP), y[:, None].expand(CROP, CROP)], dim=-1)
    grid = grid.expand(len(pictures), -1, -1, -1)
    return F.grid_sample(pictures, grid, padding_mode="reflection", align_corners=True)


def _difference(features: ImageFeatures, pair: Tensor) -> Tensor:
    """Difference between two pictures (2, 3, H, W), the second one fixed."""
    rendered, photographed = pair.contiguous(memory_format=torch.channels_last).split(1)
    with torch.autocast("cpu", torch.bfloat16, enabled=computes_bfloat16()):
        with torch.no_grad():
            target = features(photographed)
        made = features(rendered)
    total = torch.zeros(())
    for ours, theirs in zip(made, target, strict=True):
        total = total + (gram(ours) - gram(theirs))[:, :-1, :-1].abs().mean()
        powers = [torch.fft.rfft2(level.float()).abs() for level in (ours, theirs)]
        total = total + SPECTRUM * (powers[0] - powers[1]).abs().mean()
    return total
