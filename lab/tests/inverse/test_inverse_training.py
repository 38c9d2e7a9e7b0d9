"""Training of the inverse network: samples, losses, runs that continue one another."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from matcap.brdf.maps import HEIGHT
from matcap.capture.exemplar.network.inputs import network_inputs
from matcap.capture.exemplar.network.network import (
    ANSWERS,
    ERRORS,
    Inverse,
    InverseConfig,
    read_inverse,
)
from matcap_lab.inverse.samples import draw_sample, training_material
from matcap_lab.inverse.train import (
    TrainSettings,
    loss_parts,
    save_inverse,
    ship,
    total,
    train,
    wanted,
)
from matcap_lab.simulate.named import random_material

TINY = InverseConfig(widths=(8, 8, 8, 8, 8), context=8)
SMALL = TrainSettings(width=64, height=64, workers=0)


def legs(folder: Path, steps: int, config: InverseConfig = TINY, begin: Path | None = None):
    return train(folder, replace(SMALL, steps=steps), config, lambda _line: None, begin)


def test_a_sample_is_a_function_of_its_number() -> None:
    first, again, other = (draw_sample(n, 64, 64) for n in (5, 5, 6))
    assert torch.equal(first.linear, again.linear)
    assert not torch.equal(first.linear, other.linear)
    assert first.uniform == again.uniform


def test_samples_are_finite_and_within_range() -> None:
    for number in range(12):
        sample = draw_sample(number, 96, 64)
        inputs = network_inputs(sample.linear, sample.valid, sample.uniform, sample.points)
        assert bool(torch.isfinite(inputs.stacked()).all())
        assert bool(torch.isfinite(sample.truth.stacked()).all())
        assert float(sample.linear.min()) >= 0.0 and float(sample.linear.max()) <= 1.0
        # The coarse fit is about as bright as the picture.
        assert float(inputs.log.median().abs()) < 1.0


def test_held_out_patterns_are_never_trained_on() -> None:
    shown = [random_material(np.random.default_rng(seed)) for seed in range(200)]
    assert any(material.is_held_out for material in shown)
    for seed in range(40):
        realise = training_material(np.random.default_rng(seed))
        owner = getattr(realise, "__self__", None)
        assert owner is None or not hasattr(owner, "base") or not owner.is_held_out


def test_the_truth_has_no_loss_but_doubt() -> None:
    sample = draw_sample(10, 96, 64)
    truth = sample.residuals.stacked()
    certain = torch.full((ERRORS, *truth.shape[-2:]), float(np.log(0.01)))
    true = wanted([sample], np.random.default_rng(0))
    sure = torch.where(sample.metal > 0.5, 20.0, -20.0)
    parts = loss_parts(torch.cat([truth, certain, sure])[None], true)
    for name, part in parts.items():
        assert float(part) < 2e-3, name
    wrong = truth.clone()
    wrong[HEIGHT] *= 0.3
    shrunk = loss_parts(torch.cat([wrong, certain, sure])[None], true)
    assert float(shrunk["energy"]) > 0.1
    assert float(shrunk["slope"]) > 0.1


def test_legs_continue_exactly(tmp_path: Path) -> None:
    whole = legs(tmp_path / "whole", 4)
    legs(tmp_path / "runs", 2)
    resumed = legs(tmp_path / "runs", 4)
    assert resumed.step == whole.step == 4
    for a, b in zip(whole.model.parameters(), resumed.model.parameters(), strict=True):
        assert torch.equal(a, b)


def test_a_step_of_two_pictures_is_the_mean_of_theirs() -> None:
    samples = [draw_sample(number, 64, 64) for number in (1, 2)]
    outputs = 0.1 * torch.randn(2, ANSWERS, 64, 64, generator=torch.Generator().manual_seed(0))
    rng = np.random.default_rng(0)
    both = loss_parts(outputs, wanted(samples, rng))
    rng = np.random.default_rng(0)  # which draws the lights of one after the other
    each = [loss_parts(outputs[i : i + 1], wanted(samples[i : i + 1], rng)) for i in (0, 1)]
    for name, part in both.items():
        assert float(part) == pytest.approx(sum(float(e[name]) for e in each) / 2, rel=1e-4), name


def test_a_first_leg_goes_on_from_a_shipped_network(tmp_path: Path) -> None:
    torch.manual_seed(3)
    save_inverse(Inverse(TINY), tmp_path / "before.safetensors", {"steps": 7})
    before, _ = read_inverse(tmp_path / "before.safetensors")
    state = legs(tmp_path / "run", 0, begin=tmp_path / "before.safetensors")
    assert state.step == 0 and state.about["origin"] == {"steps": 7}
    for a, b in zip(before.parameters(), state.average.parameters(), strict=True):
        assert torch.equal(a, b)


def test_what_is_shipped_may_lie_on_the_way(tmp_path: Path) -> None:
    torch.manual_seed(3)
    save_inverse(Inverse(), tmp_path / "before.safetensors", {"steps": 7})
    begin = tmp_path / "before.safetensors"
    state = legs(tmp_path / "run", 1, InverseConfig(), begin)
    card = ship(tmp_path / "run", tmp_path / "between.safetensors", begin, 0.5)
    assert card["photographs_seen"] == 8 and card["share"] == 0.5
    before, between = read_inverse(begin)[0], read_inverse(tmp_path / "between.safetensors")[0]
    for a, b, c in zip(
        before.parameters(), state.average.parameters(), between.parameters(), strict=True
    ):
        assert torch.allclose((a + b) / 2.0, c, atol=1e-3)


def test_the_rate_warms_up_stays_and_falls_to_nothing() -> None:
    cooled = TrainSettings(steps=10_000, rate=1e-3, cooling=4_000)
    rates = [cooled.schedule.share(step) for step in (0, 199, 6_000, 8_000, 10_000, 10_001)]
    assert rates == pytest.approx([5e-3, 1.0, 1.0, 0.5, 0.0, 0.0])
    # A run without cooling knows nothing of its end.
    assert TrainSettings(steps=10_000).schedule.share(10_000) == 1.0


def test_a_few_steps_on_one_picture_lower_its_loss() -> None:
    torch.manual_seed(0)
    network = Inverse(TINY)
    sample = draw_sample(1, 64, 64)
    inputs = sample.inputs[None]
    true = wanted([sample], np.random.default_rng(0))
    optimiser = torch.optim.SGD(network.parameters(), lr=0.02)
    losses = []
    for _ in range(12):
        loss = total(loss_parts(network(inputs), true))
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        losses.append(float(loss.detach()))
    assert min(losses[-3:]) < losses[0]
