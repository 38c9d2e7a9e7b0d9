"""Training the prior: its configuration, and the loop."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
import torch
from torch import Tensor

from matcap.errors import UsageError
from matcap.files.color import srgb_decode
from matcap.space.decoder import DecoderConfig
from matcap.space.encoder import FEATURES, EncoderConfig, texture
from matcap.space.prior.store import Prior
from matcap.statistics.compare import Descriptor, FilterBank
from matcap_lab.train.corpus import Entry, Pack, first_of_each, srgb_bytes, true_piece
from matcap_lab.train.step import (
    Model,
    PreparedPhotograph,
    TrainConfig,
    TrainingSample,
    Turn,
    compare,
    cut,
    decode_windows,
    fits,
    prepare,
    start,
    start_from,
    step_loss,
    targets,
)
from matcap_lab.train.trainer import RateSchedule, Reporting, Training, fit, mean, mixed

# Reads a training configuration: a TOML file with the names of TrainConfig.

_Table = TypeVar("_Table", TrainConfig, EncoderConfig, DecoderConfig)


def read_config(path: Path) -> TrainConfig:
    """TrainConfig of a TOML file; missing settings keep their defaults.

    Raises:
        UsageError: no such file, no TOML, an unknown name or a value of the wrong kind.
    """
    try:
        stated = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"it cannot be read ({error.strerror})", where=str(path)) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(
            f"it cannot be read: this is not TOML ({error})", where=str(path)
        ) from error
    encoder = _filled(EncoderConfig(), stated.pop("encoder", {}), f"{path}, encoder")
    decoder = _filled(DecoderConfig(), stated.pop("decoder", {}), f"{path}, decoder")
    config = _filled(TrainConfig(), stated, str(path))
    if not fits(config.window):
        raise UsageError.at(
            path, f"the window {config.window} is no multiple of 16 from 64 on", "give 96"
        )
    return replace(config, encoder=encoder, decoder=decoder)


def _filled(default: _Table, stated: dict[str, Any], where: str) -> _Table:
    """A frozen dataclass with some of its values replaced by those of a table."""
    values: dict[str, Any] = {}
    kinds = {f.name: type(getattr(default, f.name)) for f in fields(default)}
    for name, value in stated.items():
        if name not in kinds:
            known = ", ".join(kinds)
            raise UsageError.at(where, f"there is no setting '{name}'", f"use {known}")
        kind = kinds[name]
        if kind is float and type(value) is int:
            value = float(value)
        if kind is tuple and isinstance(value, list):
            value = tuple(value)
        if type(value) is not kind:
            raise UsageError.at(where, f"'{name}' is {value!r}", f"give a {kind.__name__}")
        values[name] = value
    return replace(default, **values)


# Training the prior: encoder and decoder together, as a VAE on flash photographs alone.
#
# Each step takes a few materials. The encoder sees each whole photograph, a code is drawn, the
# decoder turns new noise and that code into maps, and the maps are rendered as at several positions
# of the photograph and compared with its windows there (statistics/compare.py). A KL term with
# warm-up keeps codes near a standard normal. trainer.py runs the steps, curves and checkpoints.

_PIECE = 512  # texels a side of the true maps that windows are cut from
_WARM_UP = 50  # steps


def schedule(steps: int) -> RateSchedule:
    """Learning rate: a short warm-up, constant, and falling to 0 over the last quarter."""
    return RateSchedule(steps, _WARM_UP, steps / 4.0, 0.02)


def train(
    pack: Pack,
    config: TrainConfig,
    out: Path,
    *,
    resume: bool = False,
    prior: Prior | None = None,
    device: str = "cpu",
    on_progress: Callable[[str], None] = lambda line: None,
) -> Training[Model]:
    """Train until config.steps, writing checkpoints, curves and a sheet into a folder.

    Starts from random weights, from a prior's networks, or with `resume` from the checkpoint.

    Raises:
        MatcapError: the checkpoint to resume from is missing, broken or of another shape.
    """
    training = start(config, device) if prior is None else start_from(prior, config, device)
    if resume:
        training.load(out)
    out.mkdir(parents=True, exist_ok=True)
    bank = FilterBank(FEATURES)
    prepared: dict[str, PreparedPhotograph] = {}

    def source(entry: Entry) -> PreparedPhotograph:
        if entry.name not in prepared:
            truth = true_piece(entry, _PIECE) if config.relit else None
            prepared[entry.name] = prepare(entry, config.encoder.width, truth)
        return prepared[entry.name]

    def loss_of(step: int) -> tuple[Tensor, Mapping[str, Tensor]]:
        rng = np.random.default_rng([config.seed, step])
        turn = Turn(bool(rng.integers(2)), int(rng.integers(4)))
        samples = [
            cut(
                source(entry), config.window, config.places,
                2 if rng.random() < config.coarse_share else 1, turn, rng,
            ).to(device)
            for entry in draw(pack.training, config, rng)
        ]  # fmt: skip
        return step_loss(training.model, step, samples, config, bank)

    def measure() -> Mapping[str, float]:
        with torch.no_grad():
            loss = held_out_loss(training.average, pack, source, config, bank, out / "sheet.png")
        return {"held_out": loss}

    reporting = Reporting(config.report_every, config.checkpoint_minutes, measure, on_progress)
    fit(training, loss_of, schedule(config.steps), out, reporting)
    return training


def draw(entries: Sequence[Entry], config: TrainConfig, rng: np.random.Generator) -> list[Entry]:
    """Draw different materials uniformly, then one photograph of each."""
    kinds: dict[bool, dict[str, list[Entry]]] = {True: {}, False: {}}
    for entry in entries:
        kinds[entry.simulated].setdefault(entry.material, []).append(entry)
    chosen: dict[str, Entry] = {}
    while len(chosen) < min(config.materials, sum(len(k) for k in kinds.values())):
        simulated = not kinds[False] or (bool(kinds[True]) and rng.random() >= config.real_share)
        materials = kinds[simulated]
        material = list(materials)[int(rng.integers(len(materials)))]
        pictures = materials[material]
        chosen[material] = pictures[int(rng.integers(len(pictures)))]
    return list(chosen.values())


_SHOWN = 6  # materials of each kind on the sheet
_SEED = 77


def held_out_loss(
    model: Model,
    pack: Pack,
    source: Callable[[Entry], PreparedPhotograph],
    config: TrainConfig,
    bank: FilterBank,
    sheet: Path,
) -> float:
    """Mean style loss of a running average on held-out materials; `source` prepares a photograph.

    Writes a sheet, a picture, of some of these and of training ones.
    """
    device = next(model.parameters()).device
    rng = np.random.default_rng(_SEED)

    def window(entry: Entry, places: int) -> TrainingSample:
        size = config.window  # at random positions, without augmentation
        return cut(source(entry), size, places, 1, Turn(), rng, augment=False).to(device)

    samples = [window(entry, config.places) for entry in first_of_each(pack.reporting)]
    losses = []
    for sample in samples:
        wanted = targets([sample], bank)
        maps = decode_windows(model.decoder, encode(model, sample, wanted[0]), [sample], _SEED)
        loss, _ = compare(maps, [sample], wanted, bank)
        losses.append(float(torch.log1p(loss)))
    seen = [window(entry, 1) for entry in first_of_each(pack.training)[:_SHOWN]]
    pictures = [_pair(model, sample, bank) for sample in [*samples[:_SHOWN], *seen]]
    if pictures:
        cv2.imwrite(str(sheet), np.hstack(pictures))
    return mean(losses)


def encode(model: Model, sample: TrainingSample, wanted: Descriptor) -> Tensor:
    """(1, CODE_SIZE) posterior mean by the averaged weights' encoder."""
    with mixed(sample.picture.device):
        return model.encoder(sample.picture[None], sample.numbers[None], texture(wanted)[None])[0]


def _pair(model: Model, sample: TrainingSample, bank: FilterBank) -> np.ndarray:
    """A window of a photograph above its reconstruction."""
    code = encode(model, sample, targets([sample], bank)[0])
    (maps,) = decode_windows(model.decoder, code, [sample], 7)
    height = maps.height[0] / sample.texel_size
    relief = (0.5 + (height - height.mean()) / 6.0).clamp(0, 1)
    rows = [
        sample.linear[0],
        sample.render(maps)[0],
        maps.diffuse[0],
        torch.from_numpy(srgb_decode(maps.roughness[0].expand(3, -1, -1).numpy())),
        (maps.specular[0].expand(3, -1, -1)) ** 0.8,
        torch.from_numpy(srgb_decode(relief.expand(3, -1, -1).numpy())),
    ]
    return np.vstack([srgb_bytes(row.cpu().numpy().transpose(1, 2, 0)) for row in rows])
