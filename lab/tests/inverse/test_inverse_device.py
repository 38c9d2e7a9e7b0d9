"""Training takes place on the device it was asked to.

Without a second device here, one is played: tensors of `Elsewhere` say that they are on "meta" but
carry numbers, and meeting a tensor of the CPU is an error, as it is between a CPU and a GPU.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_iter, tree_map

from matcap.capture.exemplar.network.network import Inverse, InverseConfig
from matcap_lab.inverse.samples import Sample, draw_sample
from matcap_lab.inverse.train import TrainSettings, start, step_loss
from matcap_lab.train.trainer import Training

AWAY = "meta"
TINY = InverseConfig(widths=(8, 8, 8, 8, 8), context=8)


def computed(
    _: Any,
    func: Callable[..., Any],
    types: Any,
    args: tuple[Any, ...] = (),
    kwargs: dict[str, Any] | None = None,
) -> Any:
    """An operation on the numbers; its results are where its tensors were, or where it was told."""
    kwargs = kwargs or {}
    tensors = [t for t in tree_iter((args, kwargs)) if isinstance(t, Tensor)]
    away = any(isinstance(t, Elsewhere) for t in tensors)
    if away and func is not torch.ops.aten.copy_.default:  # which may move
        here = [t for t in tensors if not isinstance(t, Elsewhere) and t.dim() > 0]
        if here:
            raise RuntimeError(f"{func} meets a tensor of the CPU, of shape {tuple(here[0].shape)}")
    if "device" in kwargs and kwargs["device"] is not None:
        away = torch.device(kwargs["device"]).type == AWAY
        kwargs = {**kwargs, "device": "cpu"}

    def bare(value: Any) -> Any:
        return value.numbers if isinstance(value, Elsewhere) else value

    results = func(*tree_map(bare, args), **tree_map(bare, kwargs))
    changed = {id(bare(t)): t for t in tensors}

    def put(value: Any) -> Any:
        if not isinstance(value, Tensor):
            return value
        if id(value) in changed:  # done in place
            return changed[id(value)]
        return Elsewhere(value) if away else value

    return tree_map(put, results)


class Elsewhere(Tensor):
    """A tensor of another device."""

    numbers: Tensor
    __torch_dispatch__ = classmethod(computed)

    @staticmethod
    def __new__(cls, numbers: Tensor) -> Elsewhere:
        made: Elsewhere = torch.Tensor._make_wrapper_subclass(  # type: ignore[attr-defined]
            cls,
            numbers.shape,
            strides=numbers.stride(),
            dtype=numbers.dtype,
            device=AWAY,
            requires_grad=numbers.requires_grad,
        )
        made.numbers = numbers.detach()
        return made


class Played(TorchDispatchMode):
    """Also sees operations whose tensors all are on the CPU: a move is one."""

    __torch_dispatch__ = computed


def test_the_played_device_tells_strangers_apart() -> None:
    with Played():
        there = torch.ones(2).to(AWAY)
        assert there.device.type == AWAY
        assert float((there * 2.0).sum()) == 4.0
        with pytest.raises(RuntimeError, match="meets a tensor of the CPU"):
            there + torch.ones(2)


def test_a_step_stays_on_its_device() -> None:
    sample = draw_sample(2, 64, 64)
    settings = TrainSettings()
    expected = stepped(start(TINY, settings), sample.inputs, sample, settings)
    with Played():
        away = TrainSettings(device=AWAY)
        training = start(TINY, away)
        found = stepped(training, sample.inputs, sample, away)
    assert found == pytest.approx(expected, rel=1e-3)
    assert all(p.device.type == AWAY for p in training.model.parameters())


def stepped(
    training: Training[Inverse], inputs: Tensor, sample: Sample, settings: TrainSettings
) -> dict[str, float]:
    loss, parts = step_loss(training.model, 0, [(inputs, sample)], settings)
    training.update(loss, 1.0)
    return {name: float(part.detach()) for name, part in parts.items()}
