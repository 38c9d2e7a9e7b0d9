"""Monitoring of training: loss on held-out materials, and a sheet of pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from matcap.files.srgb import srgb_decode_tensor, srgb_picture
from matcap.lab.train.pack import Entry, Pack, first_of_each
from matcap.lab.train.state import Model, TrainConfig
from matcap.lab.train.step import compare, decode_windows, targets
from matcap.lab.train.trainer import mean, mixed
from matcap.lab.train.training_windows import PreparedPhotograph, TrainingSample, Turn, cut
from matcap.space.prior.encoder_input import texture
from matcap.statistics.compare import Descriptor
from matcap.statistics.filterbank import FilterBank

_SHOWN = 6  # materials of each kind on the sheet
_SEED = 77

With = tuple[FilterBank, str]  # features, and the device


def held_out_loss(
    model: Model,
    pack: Pack,
    source: Callable[[Entry], PreparedPhotograph],
    config: TrainConfig,
    using: With,
    sheet: Path,
) -> float:
    """Mean style loss on held-out materials; writes a sheet of some of these and of training ones.

    Args:
        model: the running average.
        pack: of photographs.
        source: prepares one.
        config: of the training.
        using: features and device.
        sheet: path of the picture.
    """
    bank, device = using
    rng = np.random.default_rng(_SEED)

    def window(entry: Entry, places: int) -> TrainingSample:
        return cut_plain(source(entry), config.window, places, rng).to(device)

    samples = [window(entry, config.places) for entry in first_of_each(pack.reporting)]
    losses = []
    for sample in samples:
        wanted = targets([sample], bank, device)
        code = encode(model, sample, wanted[0], device)
        maps = decode_windows(model.decoder, code, [sample], _SEED, device)
        loss, _ = compare(maps, [sample], wanted, bank, device)
        losses.append(float(torch.log1p(loss)))
    seen = [window(entry, 1) for entry in first_of_each(pack.training)[:_SHOWN]]
    pictures = [_pair(model, sample, bank, device) for sample in [*samples[:_SHOWN], *seen]]
    if pictures:
        cv2.imwrite(str(sheet), np.hstack(pictures))
    return mean(losses)


def cut_plain(
    source: PreparedPhotograph, size: int, places: int, rng: np.random.Generator
) -> TrainingSample:
    """Windows at random positions, without augmentation."""
    return cut(source, size, places, 1, Turn(), rng, augment=False)


def encode(model: Model, sample: TrainingSample, wanted: Descriptor, device: str) -> Tensor:
    """(1, CODE_SIZE) posterior mean by the averaged weights' encoder."""
    with mixed(device):
        return model.encoder(
            sample.picture[None].to(device),
            sample.numbers[None].to(device),
            texture(wanted)[None],
        )[0]


def _pair(model: Model, sample: TrainingSample, bank: FilterBank, device: str) -> np.ndarray:
    """A window of a photograph above its reconstruction."""
    code = encode(model, sample, targets([sample], bank, device)[0], device)
    (maps,) = decode_windows(model.decoder, code, [sample], 7, device)
    height = maps.height[0] / sample.texel_size
    rows = [
        sample.linear[0],
        sample.render(maps)[0],
        maps.diffuse[0],
        srgb_decode_tensor(maps.roughness[0].expand(3, -1, -1)),
        (maps.specular[0].expand(3, -1, -1)) ** 0.8,
        srgb_decode_tensor((0.5 + (height - height.mean()) / 6.0).clamp(0, 1).expand(3, -1, -1)),
    ]
    return np.vstack([_shown(row) for row in rows])


def _shown(linear: Tensor) -> np.ndarray:
    code = srgb_picture(linear.cpu().numpy().transpose(1, 2, 0)[..., ::-1])
    return (code * 255.0).round().astype(np.uint8)
