"""Training of the inverse network in legs that continue one another exactly.

A step shows one simulated photograph; samples are a pure function of the step's number, made by
worker processes ahead of their use. The state (weights, their running average, Adam's moments,
step) is one safetensors file, replaced whole. What is shipped is the average.
"""

from __future__ import annotations

import json
import multiprocessing
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from multiprocessing.pool import AsyncResult
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import safe_open
from torch import Tensor

from matcap.capture.piece.network.inputs import network_inputs
from matcap.capture.piece.network.network import Inverse, InverseConfig
from matcap.capture.piece.network.store import read_inverse, save_inverse
from matcap.errors import MatcapError
from matcap.files.tensors import write_tensors
from matcap.lab.inverse.losses import Compare, LossWeights, compared, loss_parts, total, wanted
from matcap.lab.inverse.packed import training_sets
from matcap.lab.inverse.samples import (
    HELD_OUT,
    HELD_OUT_PATTERNS,
    REAL_SHARE,
    Sample,
    draw_sample,
)

_AHEAD = 4  # samples made before they are wanted
_STATE = "state.safetensors"
_WARM_UP = 200  # steps


@dataclass(frozen=True)
class TrainSettings:
    """How a leg is trained.

    Attributes:
        steps: to have done in all at the end of the leg.
        seconds: to end after, if sooner.
        rate: Adam's.
        cooling: steps before the last over which the rate falls to nothing.
        average: decay of the weights' running average.
        width, height: texels of a picture, multiples of 32.
        batch: pictures a step.
        save_every: steps.
        workers: processes that make samples.
        device: "cpu" or "cuda".
        style_every: steps, in one of which statistics of relit pictures are compared.
        compiled: losses are compiled, which takes minutes once and pays in a leg of an hour.
        maps: packed real materials (packed.py), of which those not held out are shown; or none.
        real: share of photographs of them.
    """

    steps: int = 100_000
    seconds: float = float("inf")
    rate: float = 1e-3
    cooling: int = 0
    average: float = 0.999
    width: int = 224
    height: int = 160
    batch: int = 1
    save_every: int = 100
    workers: int = 1
    device: str = "cpu"
    style_every: int = 2
    compiled: bool = False
    maps: Path | None = None
    real: float = REAL_SHARE

    def rate_at(self, step: int) -> float:
        """Adam's rate at a step: a short warm-up, then flat, then down to nothing."""
        left = (self.steps - step) / self.cooling if self.cooling else 1.0
        return self.rate * min(1.0, step / _WARM_UP, max(left, 0.0))


class State:
    """What training goes on from.

    Attributes:
        step: steps done.
        shown: photographs seen by them.
        origin: card of the shipped network that the first leg went on from, or nothing.
        model, average: the network, and its weights' running average.
        first, second: Adam's moments, a parameter each.
    """

    def __init__(self, config: InverseConfig, device: str) -> None:
        torch.manual_seed(0)
        self.step = 0
        self.shown = 0
        self.origin: dict[str, Any] = {}
        self.model = Inverse(config).to(device)
        self.average = Inverse(config).to(device)
        self.average.load_state_dict(self.model.state_dict())
        self.average.requires_grad_(False)
        self.first = [torch.zeros_like(p) for p in self.model.parameters()]
        self.second = [torch.zeros_like(p) for p in self.model.parameters()]

    def save(self, path: Path) -> None:
        """Write whole or not at all."""
        tensors = {f"model.{k}": v for k, v in self.model.state_dict().items()}
        tensors |= {f"average.{k}": v for k, v in self.average.state_dict().items()}
        for name, moments in (("first", self.first), ("second", self.second)):
            tensors |= {f"{name}.{i}": m for i, m in enumerate(moments)}
        write_tensors(path, tensors, self._told())

    def _told(self) -> dict[str, str]:
        told = {"step": self.step, "shown": self.shown, "origin": self.origin}
        return {name: json.dumps(value) for name, value in told.items()}

    def begin(self, path: Path) -> None:
        """Go on from a shipped network: its weights, no step done."""
        network, self.origin = read_inverse(path)
        for part in (self.model, self.average):
            part.load_state_dict(network.state_dict())

    def load(self, path: Path) -> None:
        """Go on from a file."""
        with safe_open(path, framework="pt") as file:
            told = file.metadata()
            self.step = json.loads(told["step"])
            self.shown = json.loads(told.get("shown", told["step"]))
            self.origin = json.loads(told.get("origin", "{}"))
            for part, network in (("model", self.model), ("average", self.average)):
                network.load_state_dict(
                    {k: file.get_tensor(f"{part}.{k}") for k in network.state_dict()}
                )
            for name, moments in (("first", self.first), ("second", self.second)):
                for index, moment in enumerate(moments):
                    moment.copy_(file.get_tensor(f"{name}.{index}"))


def train(
    folder: Path,
    settings: TrainSettings,
    config: InverseConfig = InverseConfig(),  # noqa: B008
    tell: Callable[[str], None] = print,
    begin: Path | None = None,
) -> State:
    """Train one leg, from the state in a folder if there is one.

    Args:
        folder: for `state.safetensors`.
        settings: of the leg.
        config: shape of the network.
        tell: called with a line every 50 steps.
        begin: a shipped network that the first leg goes on from.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / _STATE
    state = State(config, settings.device)
    if path.exists():
        state.load(path)
    elif begin:
        state.begin(begin)
    began = time.monotonic()
    running: dict[str, float] = {}
    samples = _samples(state.step, settings)
    compare: Compare = torch.compile(compared, dynamic=False) if settings.compiled else compared
    for batch in samples:
        if state.step >= settings.steps or time.monotonic() - began > settings.seconds:
            break
        parts = train_step(state, batch, settings, compare)
        for name, value in parts.items():
            running[name] = 0.98 * running.get(name, value) + 0.02 * value
        if state.step % 50 == 0:
            shown = " ".join(f"{name} {value:.3f}" for name, value in running.items())
            tell(f"{state.step} {time.monotonic() - began:.0f} s {shown}")
        if state.step % settings.save_every == 0:
            state.save(path)
    samples.close()
    state.save(path)
    return state


def train_step(
    state: State,
    samples: list[tuple[Tensor, Sample]],
    settings: TrainSettings,
    compare: Compare = compared,
) -> dict[str, float]:
    """One step of Adam; returns the loss's parts.

    Args:
        state: changed in place.
        samples: inputs and truth, of one size.
        settings: of the leg.
        compare: `losses.compared`, or that compiled.
    """
    device = settings.device
    inputs = torch.stack([x for x, _ in samples]).to(device)
    rng = np.random.default_rng([state.step, 0, 5])
    truth = wanted([sample.to(device) for _, sample in samples], rng)
    outputs = state.model(inputs.contiguous(memory_format=torch.channels_last))
    # Statistics take as long as all else: in every so manieth step, and count as much more there.
    styled = state.step % settings.style_every == 0
    parts = loss_parts(outputs, truth, style=styled, compare=compare)
    weights = LossWeights()
    loss = total(parts, replace(weights, style=weights.style * settings.style_every))
    parameters: list[Tensor] = list(state.model.parameters())
    gradients = torch.autograd.grad(loss, parameters)
    state.step += 1
    state.shown += len(samples)
    _adam(state, parameters, gradients, settings.rate_at(state.step))
    decay = min(settings.average, state.step / (state.step + 10.0))
    with torch.no_grad():
        torch._foreach_lerp_(list(state.average.parameters()), parameters, 1.0 - decay)
    return {name: float(part.detach()) for name, part in parts.items()}


@torch.no_grad()
def _adam(
    state: State, parameters: list[Tensor], gradients: tuple[Tensor, ...], rate: float
) -> None:
    """Adam with gradients of a norm of at most 1."""
    norm = torch.stack(torch._foreach_norm(gradients)).norm()
    if not bool(torch.isfinite(norm)):
        return  # one unlucky picture is left out
    clipped = torch._foreach_mul(gradients, float(1.0 / norm.clamp_min(1.0)))
    one, two = 0.9, 0.99
    correction = (1.0 - two**state.step) ** 0.5 / (1.0 - one**state.step)
    torch._foreach_lerp_(state.first, clipped, 1.0 - one)
    torch._foreach_mul_(state.second, two)
    torch._foreach_addcmul_(state.second, clipped, clipped, 1.0 - two)
    spread = torch._foreach_sqrt(state.second)
    torch._foreach_add_(spread, 1e-8)
    torch._foreach_addcdiv_(parameters, state.first, spread, -rate * correction)


def _samples(
    step: int, settings: TrainSettings
) -> Generator[list[tuple[Tensor, Sample]], None, None]:
    """Batches from a step on, made ahead by worker processes."""
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
    inputs = network_inputs(sample.linear, sample.valid, sample.uniform, sample.points).stacked()
    return inputs, sample


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
        before: the network that it went on from, to be met on the way: between the two it is often
            better than either on what neither was trained on.
        share: of the way from there to the training's; 1 is the training's.

    Raises:
        MatcapError: the folder holds no training.
    """
    state = _trained(folder)
    seen = state.origin.get("photographs_seen", state.origin.get("steps", 0))
    card: dict[str, Any] = {
        "steps": state.step,
        "photographs_seen": seen + state.shown,
        "photographs": "of real map sets and simulated materials (matcap/lab/inverse/samples.py)",
        "held_out": [
            *HELD_OUT,
            *(f"random materials of {name}" for name in HELD_OUT_PATTERNS),
            "real sets by name (matcap/lab/inverse/packed.py, is_held_out)",
        ],
    }
    if before:
        other = read_inverse(before)[0].state_dict()
        here = state.average.state_dict()
        state.average.load_state_dict({k: other[k].lerp(v, share) for k, v in here.items()})
        card["share"] = share
    save_inverse(state.average, out, card)
    return card


def _trained(folder: Path) -> State:
    path = folder / _STATE
    if not path.is_file():
        raise MatcapError(
            "there is no training in this folder",
            where=str(folder),
            remedy="give the folder that `matcap inverse train` was given",
        )
    state = State(InverseConfig(), "cpu")
    state.load(path)
    return state
