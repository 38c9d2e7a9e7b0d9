"""Trains the alignment branch on simulated photographs, whose tilt is known.

Procedural materials under random setups, tilted evenly up to 15 degrees either way. The same pool
serves many epochs: every time a photograph is mirrored along either axis and its colours permuted.
A seed is a material, so seeds never used in training are unseen materials.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from matcap.lab.simulate.materials.varied import random_material
from matcap.lab.simulate.photograph import PhoneCamera, expose, take
from matcap.lab.train.corpus import QUALITY, random_setup, srgb_bytes
from matcap.lab.train.pack import decode
from matcap.lab.train.trainer import RateSchedule, Training, mean, mixed
from matcap.photo.photo import Photo
from matcap.space.alignment import WIDTH, Alignment
from matcap.space.encoder import PICTURE_CHANNELS
from matcap.space.prior.look import picture


@dataclass(frozen=True)
class Tilted:
    """Simulated photographs and their truth.

    Attributes:
        pictures: (N, 5, h, WIDTH) as the network is shown them.
        fov: (N,) degrees.
        tilt: (N, 2) radians.
    """

    pictures: Tensor
    fov: Tensor
    tilt: Tensor


def tilted_photo(seed: int, width: int = 512) -> tuple[Photo, tuple[float, float]]:
    """A developed photograph of a procedural material, tilted up to 15 degrees, and its tilt."""
    rng = np.random.default_rng([20213, seed])
    material = random_material(rng)
    camera = PhoneCamera(
        width=width,
        height=width * 3 // 4,
        focal_length=int(rng.integers(24, 44)),
        full_well=float(rng.uniform(3000.0, 12000.0)),
        supersampling=1,
        brightness=float(rng.uniform(0.15, 0.32)),
        clipped=float(rng.uniform(0.0, 0.04)),
    )
    setup = random_setup(rng, None)
    shot = take(lambda w, h, texel: material.realise(w, h, seed, texel), camera, setup)
    code = srgb_bytes(expose(shot, seed))
    jpeg = cv2.imencode(".jpg", code, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()
    return decode(jpeg, f"tilted_{seed}", camera.fov), setup.tilt


def make(seeds: range, width: int = WIDTH) -> Tilted:
    """Photographs of as many materials, taken `width` pixels across and then made small."""
    pictures, fov, tilts = [], [], []
    for seed in seeds:
        photo, tilt = tilted_photo(seed, width)
        pictures.append(picture(photo.pixels, WIDTH).half())
        fov.append(photo.fov)
        tilts.append(tilt)
    return Tilted(torch.stack(pictures), torch.tensor(fov), torch.tensor(tilts).float())


def mirror(pictures: Tensor, tilt: Tensor, along_x: bool, along_y: bool) -> tuple[Tensor, Tensor]:
    """Mirrored pictures (B, 5, h, w), coordinates included, and what their tilts become."""
    sign = torch.ones(PICTURE_CHANNELS)
    if along_x:
        pictures, sign[3], tilt = pictures.flip(-1), -1.0, tilt * torch.tensor([1.0, -1.0])
    if along_y:
        pictures, sign[4], tilt = pictures.flip(-2), -1.0, tilt * torch.tensor([-1.0, 1.0])
    return pictures * sign[:, None, None], tilt


def train_alignment(
    pool: Tilted,
    steps: int,
    *,
    batch: int = 24,
    rate: float = 1.5e-3,
    seed: int = 0,
    on_progress: Callable[[str], None] = lambda line: None,
) -> Alignment:
    """Train from nothing, on a smooth L1 of the angles, the rate falling from the first step on."""
    torch.manual_seed(seed)
    network = Alignment().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    training = Training(network, {"": rate}, decay=0.0, weight_decay=0.02)
    schedule = RateSchedule(steps, 30, steps)
    rng = np.random.default_rng(seed)
    errors: list[float] = []
    for step in range(steps):
        chosen = torch.from_numpy(rng.integers(0, len(pool.fov), batch))
        pictures, tilt = mirror(
            pool.pictures[chosen].float(),
            pool.tilt[chosen],
            bool(rng.integers(2)),
            bool(rng.integers(2)),
        )
        order = torch.from_numpy(np.concatenate([rng.permutation(3), [3, 4]]))
        with mixed("cpu"):
            found = network(pictures[:, order], pool.fov[chosen])
        training.update(F.smooth_l1_loss(found, tilt, beta=0.02), schedule.share(step))
        errors.append(math.degrees(float((found.detach() - tilt).abs().mean())))
        if step % 50 == 49:
            on_progress(f"step {step + 1}  mean error {mean(errors[-50:]):.2f} degrees")
    return network.eval()


def evaluate_alignment(network: Alignment, unseen: Tilted) -> Tensor:
    """(N, 2) errors in degrees."""
    with torch.inference_mode():
        found = torch.cat(
            [
                network(p.float(), f)
                for p, f in zip(unseen.pictures.split(16), unseen.fov.split(16), strict=True)
            ]
        )
    return torch.rad2deg(found - unseen.tilt)
