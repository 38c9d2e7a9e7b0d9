"""One trainer for every network: AdamW, averaged weights, schedule, checkpoints and curves.

Everything random in a step follows from its number, so weights, moments and step are the whole
state: a run killed at any time goes on from its last checkpoint as if nothing had happened. Each
network's samples and losses are in train/training.py and inverse/train.py.
"""

from __future__ import annotations

import copy
import csv
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from matcap.errors import MatcapError
from matcap.field.field import computes_bfloat16
from matcap.files.output import Output
from matcap.files.tensors import write_tensors

Trained = TypeVar("Trained", bound=nn.Module)

CHECKPOINT, CURVES = "checkpoint.safetensors", "curves.csv"
_FORMAT, _VERSION = "matcap-checkpoint", 2
_MOMENTS = ("exp_avg", "exp_avg_sq")
_BETAS = (0.9, 0.99)


@dataclass(frozen=True)
class RateSchedule:
    """Learning-rate schedule and number of steps."""

    steps: int
    """Total number of steps."""
    warm_up: int
    """Steps over which the rate rises."""
    cooling: float = 0.0
    """Last steps, over which the rate falls; 0 for a run without a planned end."""
    least: float = 0.0
    """Final share of the rate."""
    seconds: float = math.inf
    """Time limit, seconds."""

    def share(self, step: int) -> float:
        """Share of the full learning rate at a step counted from 0."""
        left = (self.steps - step) / self.cooling if self.cooling else 1.0
        return min(1.0, (step + 1) / self.warm_up) * min(1.0, max(self.least, left, 0.0))


class Training(Generic[Trained]):
    """State of training: a network, its running average, AdamW's moments, and the step.

    The average is what is shipped.
    """

    def __init__(
        self, model: Trained, rates: Mapping[str, float], *, decay: float, weight_decay: float = 0.0
    ) -> None:
        """Begin with a network on its device.

        `rates` are AdamW's by a prefix of its parameters' names; `decay` is the running average's.
        """
        self.model, self.average = model, copy.deepcopy(model).requires_grad_(False)
        self.step, self._decay = 0, decay
        self.about: dict[str, Any] = {}
        self._rates = list(rates.values())
        groups = [
            {"params": [p for name, p in model.named_parameters() if name.startswith(prefix)]}
            for prefix in rates
        ]
        self.optimiser = torch.optim.AdamW(
            groups, self._rates[0], betas=_BETAS, weight_decay=weight_decay
        )

    def update(self, loss: Tensor, share: float) -> None:
        """One step of AdamW, with gradients clipped to a norm of 1, and of the running average.

        The rates are scaled by `share` (RateSchedule). A step whose gradient is not finite is
        skipped.
        """
        for group, rate in zip(self.optimiser.param_groups, self._rates, strict=True):
            group["lr"] = rate * share
        parameters: list[Tensor] = list(self.model.parameters())
        gradients = torch.autograd.grad(loss, parameters)
        self.step += 1
        norm = torch.stack(torch._foreach_norm(gradients)).norm()
        if bool(torch.isfinite(norm)):
            least = norm.clamp_min(1.0)
            for parameter, gradient in zip(parameters, gradients, strict=True):
                parameter.grad = gradient / least
            self.optimiser.step()
            self.optimiser.zero_grad(set_to_none=True)
        decay = min(self._decay, self.step / (self.step + 10.0))
        with torch.no_grad():
            torch._foreach_lerp_(list(self.average.parameters()), parameters, 1.0 - decay)

    def save(self, folder: Path) -> None:
        """Write the checkpoint atomically."""
        about = {"format": _FORMAT, "version": str(_VERSION), "step": str(self.step)}
        write_tensors(
            folder / CHECKPOINT, self._tensors(), {**about, "about": json.dumps(self.about)}
        )

    def load(self, folder: Path) -> None:
        """Go on where a checkpoint was written.

        Raises:
            MatcapError: it is missing, broken, or belongs to another configuration; the tensor
                that differs is named.
        """
        path = folder / CHECKPOINT
        remedy = "start again, in another folder or without --resume"
        metadata, tensors = read_tensors(path, (_FORMAT, _VERSION), "checkpoint", remedy)
        for parameter in self.model.parameters():  # AdamW's state, else created in its first step
            moments = {name: torch.zeros_like(parameter) for name in _MOMENTS}
            self.optimiser.state[parameter] = {"step": torch.zeros(()), **moments}
        for name, tensor in self._tensors().items():
            if name not in tensors or tensors[name].shape != tensor.shape:
                has = tuple(tensors[name].shape) if name in tensors else "nothing"
                raise MatcapError.at(
                    path,
                    f"tensor '{name}' should be {tuple(tensor.shape)} and is {has}",
                    "use the configuration it was trained with",
                )
            with torch.no_grad():
                tensor.copy_(tensors[name])
        self.step, self.about = int(metadata["step"]), json.loads(metadata["about"])

    def _tensors(self) -> dict[str, Tensor]:
        """All tensors of the state by name, not copied."""
        tensors = {f"model.{k}": v for k, v in self.model.state_dict().items()}
        tensors |= {f"average.{k}": v for k, v in self.average.state_dict().items()}
        for name, parameter in self.model.named_parameters():
            for key, value in self.optimiser.state.get(parameter, {}).items():
                tensors[f"optimiser.{key}.{name}"] = value
        return tensors


@dataclass(frozen=True)
class Reporting:
    """Reports of a run: progress lines, curves and checkpoints."""

    every: int
    """Steps between rows of the curves."""
    minutes: float
    """Minutes between checkpoints."""
    measure: Callable[[], Mapping[str, float]] = field(default=dict)
    """Callback for more columns, at each row."""
    on_progress: Callable[[str], None] = field(default=lambda _line: None)
    """Callback with each row as text."""


# A step's loss, and its parts.
LossOf = Callable[[int], tuple[Tensor, Mapping[str, Tensor]]]


def fit(
    training: Training[Trained],
    loss_of: LossOf,
    schedule: RateSchedule,
    folder: Path | None,
    reporting: Reporting,
) -> None:
    """Train in place until the schedule ends, writing checkpoints and curves into a folder, if any.

    `loss_of` gives the loss of a step by its number.
    """
    curves = Curves(None if folder is None else folder / CURVES, training.step)
    began = saved = time.monotonic()
    while training.step < schedule.steps and time.monotonic() - began < schedule.seconds:
        loss, parts = loss_of(training.step)
        training.update(loss, schedule.share(training.step))
        curves.note({name: float(part.detach()) for name, part in parts.items()})
        if training.step % reporting.every == 0 or training.step == schedule.steps:
            reporting.on_progress(curves.write(training.step, reporting.measure()))
        if folder is not None and time.monotonic() - saved > 60.0 * reporting.minutes:
            training.save(folder)
            saved = time.monotonic()
    if folder is not None:
        training.save(folder)


class Curves:
    """A CSV of losses over steps; continues that of the run it resumes."""

    def __init__(self, path: Path | None, step: int) -> None:
        self._path, self._notes = path, list[Mapping[str, float]]()
        self._rows: list[dict[str, float]] = []
        if step and path is not None and path.is_file():
            with path.open(encoding="utf-8") as file:
                read = [{k: float(v or "nan") for k, v in r.items()} for r in csv.DictReader(file)]
            self._rows = [row for row in read if row["step"] <= step]
        self._before = self._rows[-1]["seconds"] if self._rows else 0.0
        self._started = time.monotonic()

    def note(self, parts: Mapping[str, float]) -> None:
        """Record one step's losses."""
        self._notes.append(parts)

    def write(self, step: int, more: Mapping[str, float]) -> str:
        """Write a row of means since the last row, and `more`; returns it as a line."""
        seconds = self._before + time.monotonic() - self._started
        names = dict.fromkeys(name for note in self._notes for name in note)
        row = {"step": float(step), "seconds": seconds}
        row |= {name: mean([n[name] for n in self._notes if name in n]) for name in names}
        self._rows.append({**row, **more})
        self._notes.clear()
        if self._path is not None:
            columns = list(dict.fromkeys(name for row in self._rows for name in row))
            with Output.file(self._path) as path, path.open("w", newline="") as file:
                writer = csv.DictWriter(file, columns, restval=math.nan, lineterminator="\n")
                writer.writeheader()
                writer.writerows(self._rows)
        return "  ".join(f"{name} {value:.4g}" for name, value in self._rows[-1].items())


def read_tensors(
    path: Path, kind: tuple[str, int], what: str, remedy: str
) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Metadata and tensors of a file whose metadata has a kind, (format, version).

    Errors call it `what` and end with `remedy`.

    Raises:
        MatcapError: it is missing or broken, or of another kind.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except FileNotFoundError as error:
        raise MatcapError.at(path, f"there is no such {what}", remedy) from error
    except (SafetensorError, OSError) as error:
        raise MatcapError.at(path, f"the {what} cannot be read ({error})", remedy) from error
    if (metadata.get("format"), metadata.get("version")) != (kind[0], str(kind[1])):
        raise MatcapError.at(path, f"this is not a {what} of version {kind[1]}", remedy)
    return metadata, tensors


def mixed(device: torch.device | str) -> torch.autocast:
    """A context in which networks and features are computed in bfloat16 on a device.

    A processor that has to emulate bfloat16 computes in float32, in a third of the time.
    """
    kind = torch.device(device).type
    return torch.autocast(kind, torch.bfloat16, enabled=kind != "cpu" or computes_bfloat16())


def mean(values: Sequence[float]) -> float:
    """Mean of values; NaN if there are none."""
    return sum(values) / len(values) if values else math.nan
