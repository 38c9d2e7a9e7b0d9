"""Checkpoints of training: one safetensors file with weights, running mean, optimiser and step."""

from __future__ import annotations

from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from matcap.errors import MatcapError
from matcap.files.tensors import write_tensors
from matcap.lab.train.state import TrainingState

VERSION = 1
_REMEDY = "start again without --resume"


def save_checkpoint(path: Path, state: TrainingState) -> None:
    """Write a checkpoint; whole or not at all."""
    about = {"format": "matcap-checkpoint", "version": str(VERSION), "step": str(state.step)}
    write_tensors(path, _tensors(state), about)


def load_checkpoint(path: Path, state: TrainingState) -> None:
    """Bring a fresh state to where a checkpoint was written.

    Raises:
        MatcapError: it is missing, broken, or belongs to another configuration; the tensor that
            differs is named.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            found = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise MatcapError(
            f"the checkpoint cannot be read ({error})", where=str(path), remedy=_REMEDY
        ) from error
    if metadata.get("format") != "matcap-checkpoint" or metadata.get("version") != str(VERSION):
        raise MatcapError(
            f"this is no checkpoint of version {VERSION}", where=str(path), remedy=_REMEDY
        )
    _begin_optimiser(state)
    for name, tensor in _tensors(state).items():
        if name not in found or found[name].shape != tensor.shape:
            has = tuple(found[name].shape) if name in found else "nothing"
            raise MatcapError(
                f"tensor '{name}' should be {tuple(tensor.shape)} and is {has}",
                where=str(path),
                remedy="use the configuration it was trained with",
            )
        with torch.no_grad():
            tensor.copy_(found[name])
    state.step = int(metadata["step"])


def _tensors(state: TrainingState) -> dict[str, Tensor]:
    """Every tensor of a state, by name; writing into them changes the state."""
    tensors = {f"model.{k}": v for k, v in state.model.state_dict().items()}
    tensors |= {f"average.{k}": v for k, v in state.average.state_dict().items()}
    for name, parameter in state.model.named_parameters():
        for key, value in state.optimiser.state.get(parameter, {}).items():
            tensors[f"optimiser.{key}.{name}"] = value
    return tensors


def _begin_optimiser(state: TrainingState) -> None:
    """Give Adam the state it would only make in its first step."""
    for parameter in state.model.parameters():
        state.optimiser.state[parameter] = {
            "step": torch.zeros(()),
            "exp_avg": torch.zeros_like(parameter),
            "exp_avg_sq": torch.zeros_like(parameter),
        }
