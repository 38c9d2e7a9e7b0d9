"""Training of the inverse network in runs that continue one another exactly.

A step trains on simulated photographs; samples are a pure function of their numbers, prefetched by
worker processes. lab/train/trainer.py runs the steps. The shipped weights are the running average.
"""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from multiprocessing.pool import AsyncResult
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from matcap.capture.exemplar.network.network import (
    FORMAT,
    VERSION,
    Inverse,
    InverseConfig,
    read_inverse,
)
from matcap.errors import MatcapError
from matcap.files.tensors import write_tensors
from matcap_lab.inverse.losses import WEIGHTS, Compare, compared, loss_parts, total, wanted
from matcap_lab.inverse.packed import training_sets
from matcap_lab.inverse.samples import HELD_OUT, REAL_SHARE, Sample, draw_sample
from matcap_lab.simulate.materials.varied import HELD_OUT_PATTERNS
from matcap_lab.train.trainer import CHECKPOINT, RateSchedule, Reporting, Training, fit

_AHEAD = 4  # samples made before they are wanted
_WARM_UP = 200  # steps
_REPORTED = 50  # steps
_MINUTES = 2.0  # between checkpoints
_AVERAGE = 0.999  # decay of the weights' running average
_STYLED = 2  # interval, in steps, of the loss on statistics of relit pictures

SampleBatch = list[tuple[Tensor, Sample]]  # inputs and truth, of one size


@dataclass(frozen=True)
class TrainSettings:
    """Settings of one training run of the inverse network."""

    steps: int = 1_000_000
    """Total number of steps at the end of the run."""
    seconds: float = float("inf")
    """Time limit of the run."""
    rate: float = 4e-4
    """Adam's learning rate."""
    cooling: int = 0
    """Number of last steps over which the learning rate falls to 0."""
    width: int = 224
    height: int = 160
    """Texels of a picture, multiples of 32."""
    batch: int = 1
    """Pictures a step."""
    workers: int = 1
    """Processes that make samples."""
    device: str = "cpu"
    """"cpu" or "cuda"."""
    compiled: bool = False
    """Losses are compiled: minutes once, worthwhile from an hour of training."""
    maps: Path | None = None
    """Packed real materials (packed.py), whose training sets are used; or none."""
    real: float = REAL_SHARE
    """Share of photographs of real materials."""

    @property
    def schedule(self) -> RateSchedule:
        """Learning-rate schedule."""
        return RateSchedule(self.steps, _WARM_UP, self.cooling, seconds=self.seconds)


def start(config: InverseConfig, settings: TrainSettings) -> Training[Inverse]:
    """An untrained state."""
    torch.manual_seed(0)
    model = Inverse(config).to(settings.device)
    return Training(model, {"": settings.rate}, decay=_AVERAGE)


def train(
    folder: Path,
    settings: TrainSettings,
    config: InverseConfig = InverseConfig(),  # noqa: B008
    on_progress: Callable[[str], None] = print,
    begin: Path | None = None,
) -> Training[Inverse]:
    """Train one run, from the checkpoint in a folder if there is one.

    Checkpoint and curves are written there. A first run begins with random weights, or with the
    shipped network `begin`.
    """
    training = start(config, settings)
    if (folder / CHECKPOINT).exists():
        training.load(folder)
    elif begin:
        network, origin = read_inverse(begin)
        training.about = {"origin": origin}
        for part in (training.model, training.average):
            part.load_state_dict(network.state_dict())
    samples = _samples(training.step, settings)
    compare: Compare = torch.compile(compared, dynamic=False) if settings.compiled else compared

    def loss_of(step: int) -> tuple[Tensor, Mapping[str, Tensor]]:
        batch = next(samples)
        training.about["shown"] = training.about.get("shown", 0) + len(batch)
        return step_loss(training.model, step, batch, settings, compare)

    reporting = Reporting(_REPORTED, _MINUTES, on_progress=on_progress)
    fit(training, loss_of, settings.schedule, folder, reporting)
    samples.close()
    return training


def step_loss(
    model: Inverse,
    step: int,
    batch: SampleBatch,
    settings: TrainSettings,
    compare: Compare = compared,
) -> tuple[Tensor, Mapping[str, Tensor]]:
    """Loss of a step, and its parts; `compare` is `losses.compared`, or its compiled form."""
    device = settings.device
    inputs = torch.stack([x for x, _ in batch]).to(device)
    rng = np.random.default_rng([step, 0, 5])
    truth = wanted([sample.to(device) for _, sample in batch], rng)
    outputs = model(inputs.contiguous(memory_format=torch.channels_last))
    # Statistics take as long as the rest: every _STYLED steps, with as many times their weight.
    parts = loss_parts(outputs, truth, style=step % _STYLED == 0, compare=compare)
    return total(parts, style=WEIGHTS["style"] * _STYLED), parts


def _samples(step: int, settings: TrainSettings) -> Generator[SampleBatch, None, None]:
    """Batches from a step on, prefetched by worker processes."""
    if settings.workers == 0:
        while True:
            yield [_made((step * settings.batch + i, settings)) for i in range(settings.batch)]
            step += 1
    context = multiprocessing.get_context("spawn")
    with context.Pool(settings.workers, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        waiting: list[AsyncResult[tuple[Tensor, Sample]]] = []
        number = step * settings.batch
        while True:
            while len(waiting) < _AHEAD * settings.batch:
                waiting.append(pool.apply_async(_made, ((number, settings),)))
                number += 1
            yield [waiting.pop(0).get() for _ in range(settings.batch)]


def _made(asked: tuple[int, TrainSettings]) -> tuple[Tensor, Sample]:
    number, settings = asked
    sets = training_sets(settings.maps) if settings.maps else ()
    sample = draw_sample(number, settings.width, settings.height, sets=sets, real=settings.real)
    return sample.inputs, sample


def read_network(path: Path) -> Inverse:
    """The network of a file, or the running average of a training's folder.

    Raises:
        MatcapError: it is neither.
    """
    return _trained(path).average if path.is_dir() else read_inverse(path)[0]


def ship(folder: Path, out: Path, before: Path | None = None, share: float = 1.0) -> dict[str, Any]:
    """Write a training's running average as captures read it; returns its card.

    Args:
        folder: of the training.
        out: the file.
        before: the network that it was initialised from: the interpolation of the two often
            generalises better than either.
        share: weights are (1 - share) before + share trained; 1 by default.

    Raises:
        MatcapError: the folder holds no training.
    """
    training = _trained(folder)
    origin = training.about.get("origin", {})
    seen = origin.get("photographs_seen", origin.get("steps", 0))
    card: dict[str, Any] = {
        "steps": training.step,
        "photographs_seen": seen + training.about.get("shown", 0),
        "photographs": "of real map sets and simulated materials (matcap_lab/inverse/samples.py)",
        "held_out": [
            *HELD_OUT,
            *(f"random materials of {name}" for name in HELD_OUT_PATTERNS),
            "real sets by name (matcap_lab/inverse/packed.py, is_held_out)",
        ],
    }
    if before:
        other = read_inverse(before)[0].state_dict()
        here = training.average.state_dict()
        training.average.load_state_dict({k: other[k].lerp(v, share) for k, v in here.items()})
        card["share"] = share
    save_inverse(training.average, out, card)
    return card


def _trained(folder: Path) -> Training[Inverse]:
    if not (folder / CHECKPOINT).is_file():
        raise MatcapError.at(
            folder,
            "there is no training in this folder",
            "give the folder that `matcap-lab inverse train` was given",
        )
    training = start(InverseConfig(), TrainSettings())
    training.load(folder)
    return training


def save_inverse(network: Inverse, path: Path, card: Mapping[str, Any]) -> None:
    """Write weights in half precision and a card, how they were trained, whole or not at all.

    Raises:
        MatcapError: the folder cannot be written.
    """
    tensors = {name: value.half() for name, value in network.state_dict().items()}
    about = {
        "format": FORMAT,
        "version": VERSION,
        "widths": network.config.widths,
        "context": network.config.context,
        "card": dict(card),
    }
    write_tensors(path, tensors, {"matcap": json.dumps(about)})
