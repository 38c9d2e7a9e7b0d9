"""Trains the alignment branch's fusion: the weights of its picture and of convergence.

Photographs are as wide as a capture reads them, as convergence needs fine texture; each is also
read at half its size. Each pair of angles is a sample, mirrored at random.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np
import torch
from torch import Tensor

from matcap.photo.photo import Photo
from matcap.space.alignment import Alignment, Fusion, PictureTilt, evidence
from matcap_lab.train.align import (
    EVALUATED,
    likelihood_loss,
    take_tilted,
    tilted_photographs,
    train_alignment,
    written,
)
from matcap_lab.train.trainer import RateSchedule, Reporting, Training, fit

MATERIALS = 290  # of a pool
_SHOTS = 4  # of a material
_STEPS, _BATCH, _RATE = 3000, 128, 3e-3
_JITTER = 0.05  # standard deviation of noise on the inputs' logarithms


def train_branch(
    materials: int,
    steps: int,
    *,
    fused: int = MATERIALS,
    start: Alignment | None = None,
    on_progress: Callable[[str], None] = lambda line: None,
) -> Alignment:
    """The whole branch: its network for pictures, by `steps` steps on `materials`, then the fusion.

    `fused` is the number of the fusion's materials; `start` is trained on, in place.
    """
    branch = Alignment() if start is None else start
    begun = None if start is None else branch.picture
    pool = tilted_photographs(range(materials))
    branch.picture = train_alignment(pool, steps, start=begun, on_progress=on_progress)
    branch.requires_grad_(False)
    train_fusion(branch.fusion, *samples(branch.picture, range(fused)), on_progress=on_progress)
    return branch


def samples(network: PictureTilt, seeds: Sequence[int]) -> tuple[tuple[Tensor, ...], Tensor]:
    """The fusion's four inputs for photographs of the materials of seeds, and true tilts (N, 2)."""
    inputs, tilts = [], []
    for seed in seeds:
        taken = take_tilted(seed, EVALUATED, _SHOTS)
        for shot in range(_SHOTS):
            one = taken.at(torch.tensor([shot]))
            rng = np.random.default_rng([77, seed, shot])
            photo = written(one, rng, f"{seed}_{shot}", radiometric=bool(shot % 2))
            for read in map(evidence, (photo, halved(photo))):
                conditions = read.conditions[None]
                with torch.no_grad():
                    mean, log_std = network(read.picture[None], conditions)
                inputs.append((mean, log_std, conditions, read.slopes[None]))
                tilts.append(one.tilt[0])
    return tuple(torch.cat(each) for each in zip(*inputs, strict=True)), torch.stack(tilts)


def halved(photo: Photo) -> Photo:
    """The photograph with half its pixels each way."""
    small = cv2.resize(photo.pixels, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return replace(photo, pixels=np.asarray(small, np.float32), clipped=photo.clipped[::2, ::2])


def train_fusion(
    fusion: Fusion,
    inputs: tuple[Tensor, ...],
    tilts: Tensor,
    *,
    on_progress: Callable[[str], None] = lambda line: None,
) -> None:
    """Train in place: AdamW on the negative log-likelihood of the tilts (N, 2).

    Inputs are those of samples(). `on_progress` gets a line every 500 steps.
    """
    torch.manual_seed(0)
    training = Training(
        fusion.requires_grad_(True).train(), {"": _RATE}, decay=0.0, weight_decay=0.05
    )

    def loss_of(_step: int) -> tuple[Tensor, Mapping[str, Tensor]]:
        chosen = torch.randint(0, len(tilts), (_BATCH,))
        sign = torch.ones(_BATCH, 2)
        sign[:, 1] -= 2.0 * (torch.rand(_BATCH) < 0.5)
        given, given_std, known, slopes = (each[chosen] for each in inputs)
        # A mirrored picture turns tilt_y's sign, and the slope's along x.
        across = torch.cat([sign.flip(-1), torch.ones(_BATCH, 2)], dim=1)[:, None]
        noise = (_JITTER * torch.randn(slopes.shape)).exp()
        mean, std = training.model(given * sign, given_std, known, slopes * across * noise)
        true = tilts[chosen] * sign
        error = torch.rad2deg((mean - true).abs().mean())
        return likelihood_loss(mean, std, true), {"degrees": error}

    reporting = Reporting(500, float("inf"), on_progress=on_progress)
    fit(training, loss_of, RateSchedule(_STEPS, 30, _STEPS), None, reporting)
    fusion.requires_grad_(False).eval()
