"""Training of the decoder that fine-tuning beside an exemplar starts from: it reads a drawing.

The prior's decoder is trained on, on many materials whose maps are known. Each stands for an
exemplar: relief, contrast and gloss are changed as estimates are wrong, its drawing is an input,
and a window of its maps is the teacher (matcap/space/tuning/match.py). What all materials have in
common is learnt here, so that a photograph's own fine-tuning needs few steps [nichol2018].
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file
from torch import Tensor

from matcap.brdf.maps import DIFFUSE, HEIGHT, MapSet
from matcap.example.example import Example
from matcap.example.exemplar import Exemplar
from matcap.field.plane import Rectangle
from matcap.flash.coarse.fit import CoarseFit
from matcap.flash.rectify import read_plane
from matcap.space.decoder import maps_from_raw, with_drawing
from matcap.space.freeze import AROUND, Drawing
from matcap.space.prior.store import DETAIL, Base, base_of, load_prior
from matcap.space.random_field import Patch, RandomField, noise_field
from matcap.space.tuning.finetune import Adam
from matcap.space.tuning.match import MARGIN, Lesson, log_contrast
from matcap_lab.simulate.photograph import RealiseAt, as_photo, take
from matcap_lab.train.corpus import scene_of

_SIDE, _WINDOW = 288, 96  # texels of a material's maps, and of a window
_TEXEL = 2.0 / DETAIL
_SMALLEST, _DRAWN = 1e-3, 0.02  # albedo; deviation of the first weights that read the drawing
_RATE, _FLOOR, _WARM_UP = 2e-3, 0.03, 20  # of Adam; its last share; steps
_AVERAGE = 0.99  # decay of the running mean of the weights
_PER_DRAW = 2  # windows of one changed exemplar


@dataclass(frozen=True)
class KnownMaterial:
    """Maps, and what the encoder says of a photograph."""

    maps: Tensor
    """(6, _SIDE, _SIDE) stacked maps."""
    code: Tensor
    """(CODE_SIZE,) latent vector."""


def known(material: RealiseAt | None, seed: int) -> KnownMaterial:
    """A material photographed with the camera and flash of a seed; None is that of the seed."""
    drawn, camera, setup = scene_of(seed)
    realise = material or drawn.realise
    shot = take(lambda width, height, texel: realise(width, height, seed, texel), camera, setup)
    photo, maps = as_photo(shot, seed, "known"), realise(_SIDE, _SIDE, seed + 1, _TEXEL).stacked()
    red, green, blue, specular, roughness, _ = maps.mean((1, 2)).tolist()
    coarse = CoarseFit((red, green, blue), specular, roughness, shot.setup, 0.05)
    plane = read_plane(photo, shot.setup, DETAIL)
    return KnownMaterial(maps.float(), load_prior().code(photo.pixels, coarse, plane))


def train(materials: Sequence[KnownMaterial], seconds: float, path: Path, seed: int = 2) -> None:
    """Train for a time, and write the decoder in half precision.

    Args:
        materials: without colour in F0.
        seconds: wall time, over which the rate falls.
        path: of the file, weights/drawing.safetensors.
        seed: of all random numbers.
    """
    rng = np.random.default_rng(seed)
    torch.manual_seed(seed)
    decoder = with_drawing(load_prior().decoder).requires_grad_(True)
    for weights in decoder.drawing_weights():
        weights.normal_(std=_DRAWN)
    adam, mean = Adam(decoder), {k: v.clone() for k, v in decoder.state_dict().items()}
    began, step = time.monotonic(), 0
    while (share := (time.monotonic() - began) / seconds) < 1.0:
        material = materials[int(rng.integers(len(materials)))]
        drawing, base = _estimate(material, rng)
        for _ in range(_PER_DRAW):
            lesson = _lesson(drawing, rng)
            size = _WINDOW + 2 * MARGIN
            noise = noise_field(Patch(step, Rectangle(0, 0, size, size)), 8)[None]
            with torch.autocast("cpu", torch.bfloat16):
                output = decoder(RandomField(noise, (), lesson.drawing), material.code)
            raw = base.apply(output)[..., MARGIN:-MARGIN, MARGIN:-MARGIN]
            decoder.zero_grad(set_to_none=True)
            lesson.loss(maps_from_raw(raw, _TEXEL)).backward()
            torch.nn.utils.clip_grad_norm_(decoder.parameters(), 1.0)
            pace = _FLOOR + (1.0 - _FLOOR) * (0.5 + 0.5 * math.cos(math.pi * share))
            adam.step(_RATE * pace * min(1.0, (step + 1) / _WARM_UP))
            step += 1
            with torch.no_grad():
                kept = min(_AVERAGE, 1.0 - 1.0 / (step + 1))
                for name, weight in decoder.state_dict().items():
                    mean[name].lerp_(weight, 1.0 - kept)
    save_file({name: weight.half().contiguous() for name, weight in mean.items()}, path)


def _estimate(material: KnownMaterial, rng: np.random.Generator) -> tuple[Drawing, Base]:
    """Maps with the errors of an estimate, as a drawing, and the base of a coarse fit of them."""
    maps = material.maps.rot90(int(rng.integers(4)), (1, 2)).clone()
    maps[HEIGHT] *= math.exp(rng.normal(0.0, 0.25))
    log = maps[DIFFUSE].clamp_min(_SMALLEST).log()
    middle = log.mean((1, 2), keepdim=True)
    log = (log - middle) * math.exp(rng.normal(0.0, 0.15)) + middle + rng.normal(0.0, 0.1)
    maps[DIFFUSE] = log.exp().clamp(_SMALLEST, 1.0 - _SMALLEST)
    gloss, varies = maps[3:5], rng.random()
    level = gloss.mean((1, 2), keepdim=True)
    maps[3:5] = (level + varies * (gloss - level)).clamp(0.01, 0.99)
    off = torch.from_numpy(rng.normal(0.0, (0.15, 0.15, 0.15, 0.4, 0.6))).float()
    logits = torch.logit(maps[:5].mean((1, 2)), eps=_SMALLEST) + off
    red, green, blue, specular, roughness = logits.sigmoid().tolist()
    coarse = CoarseFit((red, green, blue), specular, roughness, scene_of(0)[2], 0.05)
    contrast = log_contrast(maps[DIFFUSE], torch.ones(maps.shape[1:], dtype=torch.bool))
    drawing = Drawing(Example.of(Exemplar.certain(maps.numpy(), _TEXEL)))
    return drawing, base_of(coarse, contrast * math.exp(rng.normal(0.1, 0.2)))


def _lesson(drawing: Drawing, rng: np.random.Generator) -> Lesson:
    """A window of the maps at random."""
    beyond = MARGIN + AROUND
    maps = torch.from_numpy(drawing.example.exemplar.stacked())
    x, y = (int(n) for n in rng.integers(maps.shape[-1] - _WINDOW - 2 * beyond + 1, size=2))
    side = _WINDOW + 2 * beyond
    read = maps[:, y : y + side, x : x + side]
    inner = MapSet.from_stacked(read[None, :, beyond:-beyond, beyond:-beyond], _TEXEL)
    return Lesson(drawing.levels_of(read), inner, int(rng.integers(1 << 31)))
